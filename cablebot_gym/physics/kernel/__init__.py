"""The compiled plant: fixed-step RK4 of many robots at once, with the equations of :mod:`textbook`.

The Newton-Euler equations of a platform in space are written in the platform frame, with y = (Rᵀp̈,
ω̇) as the unknowns. Here p is the position of the centre of mass c, and b_i is the platform anchor
as seen from it:

    q_i  = ‖s_i‖,  s_i = Rᵀ(p − A_i) + b_i,  u_i = s_i/q_i,  n_i = b_i × u_i,  row_i = (u_i, n_i)
    q̇_i = u_i·w_i,  w_i = Rᵀṗ + ω × b_i,  q̈_i = row_i·y + bias_i,  bias_i = u_i·(ω×(ω×b_i)) + (w_i·w_i − q̇_i²)/q_i
    t_i  = κ_i/r_i + (J_i/r_i²) q̈_i + (c_i/r_i²) q̇_i,   T_i = max(0, t_i)  (unilateral)   or   T_i = t_i  (bilateral)
    (m I₃, I) y = (Rᵀ(m g e_z + F), RᵀM − ω × Iω) − Σ row_i T_i

For a point mass y = p̈ and row_i = u_i. For a platform in a plane y = (p̈, φ̈) and row_i = (u_i, R
b_i × u_i) in the base frame.

A swivel pulley adds terms to the bias, see :func:`space.swivelled`. Elastic cables have the
tensions of :func:`textbook.cable_springs` at the angle β of their pulley, which turns with the motor,
``J β̈ = τ − c β̇ − torque of the cable``, and the set of taut cables follows from their strain.

F and M are the external force and moment at the centre of mass in the base frame; usually they are
zero. The torque limits and the motors' friction hold at every stage of RK4, not only once per step:
the error of a saturated motor falls with the fourth power of the step, too. κ is the motor torque
less the friction (rigid) or the spring torque. The Euler accelerations are computed last. A cable
is slack when t_i ≤ 0. The set of taut cables is unique because the problem is strictly convex, so
the result does not depend on the start of the search.

The files from bottom to top: rows, arithmetic, space and plane, taut, motors, stage, integrate,
inverse, locate and entry_points. All code is inlined into the entry points: loops over lanes
vectorise only then, and only with ``error_model="numpy"``.
"""

from cablebot_gym.physics.kernel.entry_points import compiled
from cablebot_gym.physics.kernel.rows import Form

__all__ = ["Form", "compiled"]
