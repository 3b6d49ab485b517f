"""A quadruped of a user: its MJCF and its TOML."""

from pathlib import Path


def leg_of_quadruped(leg: str, x: float, y: float) -> str:
    """MJCF of a leg that is attached to the body at (x, y) [m]."""
    return f"""
  <body pos="{x} {y} 0">
    <joint name="{leg}_a" axis="1 0 0" range="-50 50"/>
    <geom size="0.03" mass="0.2"/>
    <body>
      <joint name="{leg}_h" axis="0 1 0" range="-90 180"/>
      <geom size="0.03" pos="0 0 -0.1" mass="0.4"/>
      <body pos="0 0 -0.2">
        <joint name="{leg}_k" axis="0 1 0" range="-160 0"/>
        <geom size="0.02" pos="0 0 -0.1" mass="0.1"/>
        <geom name="{leg}" size="0.02" pos="0 0 -0.2" mass="0.02"/>
      </body>
    </body>
  </body>"""


def quadruped() -> str:
    """MJCF with four legs of three joints, thigh 0.2 m and shank 0.2 m."""
    legs = ""
    for x, front in ((0.2, "F"), (-0.2, "R")):
        for y, side in ((-0.1, "R"), (0.1, "L")):
            legs += leg_of_quadruped(front + side, x, y)

    return f"""<mujoco><worldbody><body name="body" pos="0 0 1"><freejoint/>
  <geom type="box" size="0.2 0.1 0.05" mass="3"/>{legs}</body></worldbody></mujoco>"""


DOG_TOML = """
name = "dog"
motor = "a motor"
model = "dog.xml"
base = "free"
nominal_pose = [0.0, 0.8, -1.6]
kp = 20.0
kd = 0.5
torque_limit = 10.0
"""
LEG_TOML = """
[legs.{leg}]
joints = ["{leg}_a", "{leg}_h", "{leg}_k"]
foot = "{leg}"
phase = {phase}
"""
PHASES = {"FR": 0.0, "FL": 0.5, "RR": 0.5, "RL": 0.0}
LEGS_TOML = DOG_TOML + "".join(
    LEG_TOML.format(leg=leg, phase=phase) for leg, phase in PHASES.items()
)


def written(folder: Path, toml: str, name: str, xml: str) -> Path:
    """Path of the TOML `name`.toml, written to `folder` together with its MJCF."""
    (folder / f"{name}.xml").write_text(xml, encoding="utf-8")
    (folder / f"{name}.toml").write_text(toml, encoding="utf-8")
    return folder / f"{name}.toml"
