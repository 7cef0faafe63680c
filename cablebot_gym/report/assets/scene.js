// 3D view of the robot: an upright pinhole camera, as in the renderer of the package. The z axis points down.

function makeScene(canvas) {
  const context = canvas.getContext("2d");
  let robot = null, frames = null, motion = null, frame = 0, view = null;

  const minus = (a, b) => a.map((value, index) => value - b[index]);
  const dot = (a, b) => a.reduce((sum, value, index) => sum + value * b[index], 0);
  // Corners of the outline of points in the picture, in order around it (monotone chain).
  function hull(points) {
    const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    const side = (line) => {
      const corners = [];
      for (const point of line) {
        while (corners.length > 1 && turn(corners[corners.length - 2], corners[corners.length - 1], point) <= 0) corners.pop();
        corners.push(point);
      }
      return corners.slice(0, -1);
    };
    return [...side(sorted), ...side(sorted.reverse())];
  }
  const turn = (a, b, c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
  // A point of the base frame in the space of the picture.
  const solid = (point) => [0, 1, 2].map((at) => point.reduce((sum, value, axis) => sum + value * robot.axes[axis][at], 0));

  function camera() {
    const [ca, sa, ce, se] = [Math.cos(view.azimuth), Math.sin(view.azimuth), Math.cos(view.elevation), Math.sin(view.elevation)];
    const right = [ca, sa, 0], forward = [ce * sa, -ce * ca, se];
    const down = [forward[1] * right[2] - forward[2] * right[1], forward[2] * right[0] - forward[0] * right[2], forward[0] * right[1] - forward[1] * right[0]];
    const eye = robot.middle.map((value, index) => value - view.distance * forward[index]);
    const focal = 0.5 * Math.min(canvas.width, canvas.height) / Math.tan(0.28);
    return (point) => {
      const away = minus(point, eye), depth = Math.max(dot(away, forward), 0.05);
      return [canvas.width / 2 + focal * dot(away, right) / depth, canvas.height / 2 + focal * dot(away, down) / depth, focal / depth];
    };
  }

  function line(points, style) {
    context.save();
    Object.assign(context, style);
    context.setLineDash(style.dash ?? []);
    context.beginPath();
    points.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.stroke();
    context.restore();
  }

  function draw() {
    if (!frames) return;
    const style = getComputedStyle(document.documentElement), colour = (name) => style.getPropertyValue(name).trim();
    const ratio = window.devicePixelRatio || 1, inPicture = camera(), project = (point) => inPicture(solid(point));
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.lineCap = context.lineJoin = "round";
    const path = motion.path.map(project), middle = project(frames.position[frame]);
    line(path, { strokeStyle: colour("--tube"), lineWidth: Math.max(2 * motion.bound * middle[2], 3 * ratio) });
    line(path, { strokeStyle: colour("--quiet"), lineWidth: ratio, dash: [4 * ratio, 4 * ratio] });
    line(frames.position.slice(0, frame + 1).map(project), { strokeStyle: colour("--accent"), lineWidth: 2 * ratio });
    const corners = robot.base.map(project);
    line([...corners, corners[0]], { strokeStyle: colour("--line"), lineWidth: 2 * ratio });
    const width = robot.base[0].length, ends = robot.cables.map((index) => frames.anchors[frame].slice(index * width, (index + 1) * width)).map(project);
    ends.forEach((end, cable) => {
      const tension = frames.tension[frame][cable], slack = tension <= 0, fraction = Math.max(0, Math.min(1, tension / robot.fullTension));
      const start = corners[cable];
      if (slack) {  // draw it sagging
        const low = [(start[0] + end[0]) / 2, (start[1] + end[1]) / 2 + 0.08 * Math.hypot(start[0] - end[0], start[1] - end[1])];
        context.save();
        context.setLineDash([6 * ratio, 5 * ratio]);
        context.strokeStyle = colour("--quiet");
        context.lineWidth = 1.5 * ratio;
        context.beginPath();
        context.moveTo(start[0], start[1]);
        context.quadraticCurveTo(low[0], low[1], end[0], end[1]);
        context.stroke();
        context.restore();
      } else {
        line([start, end], { strokeStyle: mixColours(colour("--low"), colour("--high"), fraction), lineWidth: (1.4 + 3 * fraction) * ratio });
      }
      context.fillStyle = colour("--ink");
      context.beginPath();
      context.arc(start[0], start[1], 4 * ratio, 0, 7);
      context.fill();
      context.font = `${12 * ratio}px system-ui, sans-serif`;
      const here = robot.base.flatMap((point, other) => (String(point) === String(robot.base[cable]) ? [other + 1] : []));
      if (here[0] === cable + 1) context.fillText(here.join(", "), start[0] + 6 * ratio, start[1] - 6 * ratio);
    });
    if (robot.points > 2) {
      context.fillStyle = colour("--platform");
      context.globalAlpha = 0.85;
      context.beginPath();
      const corners = [];
      for (let point = 0; point < robot.points; point++) {
        corners.push(project(frames.anchors[frame].slice(point * width, (point + 1) * width)));
      }
      hull(corners).forEach(([x, y], corner) => {
        if (corner) context.lineTo(x, y); else context.moveTo(x, y);
      });
      context.closePath();
      context.fill();
      context.globalAlpha = 1;
    }
    const here = solid(frames.position[frame]), hung = [here[0], here[1], here[2] + (robot.hang && robot.hang + frames.radius)], ball = inPicture(hung);
    if (robot.hang) line([inPicture(here), ball], { strokeStyle: colour("--ink"), lineWidth: 1.5 * ratio });
    context.fillStyle = colour("--steel");
    context.strokeStyle = colour("--ink");
    context.lineWidth = ratio;
    context.beginPath();
    context.arc(ball[0], ball[1], Math.max(frames.radius * ball[2], 3 * ratio), 0, 7);
    context.fill();
    context.stroke();
    const goal = project(motion.path[Math.min(frame, motion.path.length - 1)]);
    context.strokeStyle = colour("--bad");
    context.lineWidth = 2 * ratio;
    context.beginPath();
    context.arc(goal[0], goal[1], Math.max(motion.bound * goal[2], 5 * ratio), 0, 7);
    context.stroke();
    canvas.setAttribute("aria-label", `The robot at ${frames.times[frame].toFixed(2)} s: position ${frames.position[frame].map((value) => value.toFixed(3)).join(", ")} m`);
  }

  function mixColours(low, high, fraction) {
    const channels = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
    const a = channels(low), b = channels(high);
    return `rgb(${a.map((value, index) => Math.round(value + fraction * (b[index] - value))).join(" ")})`;
  }

  function rotate(across, up) {
    view.azimuth += across;
    view.elevation = Math.max(-1.5, Math.min(1.57, view.elevation + up));
    draw();
  }

  function zoom(factor) {
    view.distance = Math.max(0.3 * robot.size, Math.min(8 * robot.size, view.distance * factor));
    draw();
  }

  function fit() {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
    canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    draw();
  }

  canvas.addEventListener("keydown", (event) => {
    const moves = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    if (!view) return;
    if (moves[event.key]) rotate(...moves[event.key]);
    else if (event.key === "+" || event.key === "=") zoom(0.9);
    else if (event.key === "-") zoom(1.1);
    else return;
    event.preventDefault();
  });
  let dragStart = null;
  canvas.addEventListener("pointerdown", (event) => { dragStart = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointerup", () => { dragStart = null; });
  canvas.addEventListener("pointercancel", () => { dragStart = null; });
  canvas.addEventListener("pointermove", (event) => {
    if (!dragStart || !view) return;
    rotate((dragStart[0] - event.clientX) / 150, (event.clientY - dragStart[1]) / 150);
    dragStart = [event.clientX, event.clientY];
  });
  canvas.addEventListener("wheel", (event) => {
    if (!view) return;
    zoom(event.deltaY > 0 ? 1.1 : 0.9);
    event.preventDefault();
  }, { passive: false });
  new ResizeObserver(fit).observe(canvas);

  return {
    draw,
    show(newRobot, newFrames, newMotion) {
      if (!robot || robot !== newRobot) view = { azimuth: newRobot.azimuth, elevation: newRobot.elevation, distance: 1.55 * newRobot.size };
      [robot, frames, motion] = [newRobot, newFrames, newMotion];
      frame = Math.min(frame, frames.times.length - 1);
      fit();
    },
    showFrame(index) {
      frame = index;
      draw();
    },
  };
}
