"""Environment ids and their robots."""

ENV_ROBOTS = {
    "CableBot-Planar-v0": "planar",
    "CableBot-Spatial-v0": "spatial",
    "CableBot-FlexPlanar-v0": "flex-planar",
    "CableBot-FlexSpatial-v0": "flex-spatial",
    "CableBot-Point-v0": "stadium-camera",
    "CableBot-PlanarPlatform-v0": "ttk4900",
    "CableBot-FlexPoint-v0": "flex-stadium-camera",
    "CableBot-FlexPlanarPlatform-v0": "flex-ttk4900",
}
"""Name of the robot of each environment id."""
