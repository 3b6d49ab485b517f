"""What a robot's description needs to know of a user's MJCF or URDF, and what is refused in it."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from pathlib import Path

import numpy as np

from motorprior.exceptions import ArtifactError
from motorprior.robots.robot import Leg

TRIED, UNLIKE = 0.1, 0.08
"""By how much joints are tried [rad], and how far a foot may be from where it should be [leg lengths]: offsets of real
legs are smaller, a joint that turns the other way is further."""
_LIGHTEST, _HEAVIEST = 0.3, 1.5
"""Of the smallest and the largest load: a bench goes a little beyond what a motor will meet."""


def cannot_read(path: Path | None, reason: str) -> ArtifactError:
    """The error for a model that MuJoCo cannot compile."""
    words = " ".join(reason.split())[:300]
    return ArtifactError(f"MuJoCo cannot read it ({words})", where=path, remedy="correct the model")


class UserModel:
    """A compiled model file.

    Attributes:
        num_links: moving bodies.

    Raises:
        ArtifactError: the file cannot be read or compiled, has actuators that may not be removed, or no base that fits.
    """

    def __init__(self, path: Path, is_free: bool, removes_actuators: bool):
        try:
            import mujoco  # here: a robot's own computer has none, and a shipped robot needs none
        except ModuleNotFoundError as error:
            raise ArtifactError(
                "MuJoCo is not installed, which reads a robot's model",
                where=path,
                remedy="pip install 'motorprior[full]'",
            ) from error

        self._mujoco, self._path = mujoco, path
        if not path.is_file():
            raise ArtifactError("no such model file", where=path, remedy="correct the key model")
        try:
            self._model = mujoco.MjModel.from_xml_path(str(path))
        except Exception as error:  # ValueError, FatalError or MemoryError, depending on what is wrong
            raise cannot_read(path, str(error)) from error
        if self._model.nu and not removes_actuators:
            first = self._model.actuator(0).name
            raise ArtifactError(
                f"it has {self._model.nu} actuators of its own, the first is {first!r}: a joint would be driven twice",
                where=path, remedy='delete the <actuator> section, or write actuators = "remove" in the robot\'s file',
            )  # fmt: skip
        self._require_base(is_free)
        self.num_links = self._model.nbody - 1

    @property
    def mass(self) -> float:
        """Of all its bodies [kg]."""
        return float(np.sum(self._model.body_mass))

    def _require_base(self, is_free: bool) -> None:
        free = [i for i in range(self._model.njnt) if self._model.jnt_type[i] == self._mujoco.mjtJoint.mjJNT_FREE]
        if is_free and free != [0]:
            problem = "its base is free, but the model has no free joint that comes first"
            raise ArtifactError(
                problem, where=self._path, remedy='add <freejoint/> to the base, or write base = "fixed"'
            )
        if not is_free and free:
            problem = "its base is fixed, but the model has a free joint"
            raise ArtifactError(problem, where=self._path, remedy='delete the free joint, or write base = "free"')
        roots = int(np.sum(self._model.body_parentid[1:] == 0))
        if roots != 1:
            raise ArtifactError(
                f"the world holds {roots} bodies", where=self._path, remedy="leave the robot alone in its model"
            )

    def joint_names(self, wanted: tuple[str, ...] | None) -> tuple[str, ...]:
        """Names of the hinges in the order of the model; they must be those that are ``wanted``.

        Raises:
            ArtifactError: a joint without a name or of another type, a missing, an unlisted or a misplaced one.
        """
        names = []
        for index in range(self._model.njnt):
            kind, name = self._model.jnt_type[index], self._model.joint(index).name
            if kind == self._mujoco.mjtJoint.mjJNT_FREE:
                continue
            if kind != self._mujoco.mjtJoint.mjJNT_HINGE or not name:
                problem = f"joint number {index} ({name!r}) is no hinge with a name"
                raise ArtifactError(problem, where=self._path, remedy="name it, or weld it by deleting the joint")
            names.append(name)
        if wanted is None or tuple(names) == wanted:
            return tuple(names)
        for name in wanted:
            if name not in names:
                raise ArtifactError(f"no joint {name!r}", where=self._path, remedy=f"its joints are {', '.join(names)}")
        for name in names:
            if name not in wanted:
                problem = f"joint {name!r} of the model is not in the robot's joints"
                raise ArtifactError(problem, where=self._path, remedy="list it, or weld it by deleting the joint")
        raise ArtifactError(
            "the robot's joints are in another order than the model's", where=self._path,
            remedy=f"list them as {list(names)}, or leave joints out",
        )  # fmt: skip

    def limits(self, name: str) -> tuple[float, float]:
        """Lower and upper limit of a joint [rad].

        Raises:
            ArtifactError: it has none.
        """
        joint = self._model.joint(name)
        if not self._model.jnt_limited[joint.id]:
            problem = f"joint {name!r} has no limits"
            raise ArtifactError(
                problem, where=self._path, remedy='give it range="LOWER UPPER" (and autolimits or limited)'
            )
        lower, upper = self._model.jnt_range[joint.id]
        return float(lower), float(upper)

    def leg_geometry(
        self, joints: tuple[str, ...], foot: str, pose: dict[str, float]
    ) -> tuple[float, float, float, tuple[float, float]]:
        """Thigh, shank and radius of the foot [m], and where its centre rests, forward and left of the base [m].

        Raises:
            ArtifactError: no such foot, or one that is no sphere.
        """
        known = [self._model.geom(index).name for index in range(self._model.ngeom)]
        if foot not in known:
            found = ", ".join(name for name in known if name) or "none has a name"
            raise ArtifactError(f"no foot {foot!r} among its geoms", where=self._path, remedy=f"its geoms are {found}")
        geom = self._model.geom(foot).id
        if self._model.geom_type[geom] != self._mujoco.mjtGeom.mjGEOM_SPHERE:
            raise ArtifactError(f"foot {foot!r} is no sphere", where=self._path, remedy="give the foot a sphere")
        data = self._at(pose)
        hip, knee = (data.xanchor[self._model.joint(name).id] for name in joints[1:])
        centre = data.geom_xpos[geom]
        lengths = np.linalg.norm(knee - hip), np.linalg.norm(centre - knee)
        forward, left = (float(value) for value in (centre - data.xpos[1])[:2])
        return float(lengths[0]), float(lengths[1]), float(self._model.geom_size[geom, 0]), (forward, left)

    def unlike(self, leg: Leg, names: tuple[str, ...], pose: dict[str, float]) -> str:
        """What of a leg's motion is not as `Leg` says; nothing if nothing is.

        Its joints are moved by TRIED from a pose, one at a time: hip and knee must bring the foot where `Leg.reach`
        says, a growing abduction must carry it to the left.
        """
        abduction, hip, knee = (names[joint] for joint in leg.joints)
        for moved in (None, hip, knee):
            tried = pose | ({} if moved is None else {moved: pose[moved] + TRIED})
            data = self._at(tried)
            forward, _, down = data.geom_xpos[self._geom(leg.foot)] - data.xanchor[self._model.joint(hip).id]
            told = leg.reach(np.array([tried[name] for name in names]))
            if max(abs(forward - told[0]), abs(-down - told[1])) > UNLIKE * (leg.thigh + leg.shank):
                where = "in the nominal pose" if moved is None else f"as {moved!r} grows"
                return (
                    f"{where}, foot {leg.foot!r} is {forward:.3f} m forward of and {-down:.3f} m below its hip, where "
                    f"hip and knee about +y with a straight leg at 0 would have {told[0]:.3f} and {told[1]:.3f} m"
                )
        left = self._at(pose | {abduction: pose[abduction] + TRIED}).geom_xpos[self._geom(leg.foot)]
        if left[1] <= self._at(pose).geom_xpos[self._geom(leg.foot)][1]:
            return f"foot {leg.foot!r} goes right as {abduction!r} grows, where an abduction about +x carries it left"
        return ""

    def standing_height(self, pose: dict[str, float], feet: list[str]) -> float:
        """Height of the base [m] at which the lowest of its feet touches the ground."""
        data, base = self._at(pose), 1
        bottoms = [data.geom_xpos[geom, 2] - self._model.geom_size[geom, 0] for geom in map(self._geom, feet)]
        return float(data.xpos[base, 2] - min(bottoms))

    def load_inertia(self, pose: dict[str, float], legs: int, height: float) -> tuple[float, float]:
        """Least and most inertia that a motor carries [kg·m²], with some room on both sides.

        The least is the smallest diagonal of the joints' mass matrix. The most is its largest, or, of a legged robot,
        that of its share of the mass at the height of the base.
        """
        data, own, column = self._at(pose), [], np.zeros(self._model.nv)
        self._mujoco.mj_forward(self._model, data)
        for joint in range(self._model.nv - len(pose), self._model.nv):
            self._mujoco.mj_mulM(self._model, data, column, np.eye(self._model.nv)[joint])
            own.append(float(column[joint] - self._model.dof_armature[joint]))
        share = self.mass / legs * height**2 if legs else 0.0
        return _LIGHTEST * min(own), _HEAVIEST * max(*own, share)

    def _geom(self, name: str) -> int:
        return self._model.geom(name).id

    def _at(self, pose: dict[str, float]):
        data = self._mujoco.MjData(self._model)
        for name, angle in pose.items():
            data.joint(name).qpos[0] = angle
        self._mujoco.mj_kinematics(self._model, data)
        return data
