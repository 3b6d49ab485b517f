"""A user's MJCF or URDF: MuJoCo's editable description; joints, limits, legs, mass and loads."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from motorprior.exceptions import ArtifactError
from motorprior.robots.model_source import is_urdf, mesh_file
from motorprior.robots.robot import Leg

_MESHES = (".stl", ".obj", ".msh")  # formats that MuJoCo reads

# The radius of gyration of a link must not exceed the larger of two bounds: a multiple of the
# model's size, and a length [m].
MAX_RELATIVE_GYRATION = 10.0
MAX_GYRATION = 5.0


def cannot_read(path: Path | None, reason: str) -> ArtifactError:
    """The error for a model that MuJoCo cannot compile."""
    reason = " ".join(reason.split())[:300]
    return ArtifactError(
        f"MuJoCo cannot read it ({reason})", where=path, remedy="correct the model"
    )


def read_spec(path: Path, is_free: bool, feet: Sequence[str]) -> Any:
    """The ``MjSpec`` of a model, with what a URDF cannot state.

    The root link of a URDF gets a free joint if the robot's base is free, and its meshes get the
    paths of their files. A mesh that is not found, or has a format that MuJoCo does not read, is
    removed if its link states an inertia. Where an entry of ``feet`` is the name of a link or body,
    the only sphere of this body gets this name. Raises ArtifactError for a missing mesh from which
    a link would get its inertia.
    """
    spec = mujoco.MjSpec.from_file(str(path))
    if is_urdf(path):
        # Links are not merged with fixed neighbours: they keep their names, and the base its body.
        spec.compiler.fusestatic = False
        # shapes without collisions stay for films
        spec.compiler.discardvisual = False
        _place_meshes(spec, path)
        base = spec.worldbody.first_body()
        if is_free and base is not None and base.first_joint() is None:
            base.add_freejoint()
    for foot in feet:
        body = spec.body(foot)
        geom_names = {geom.name for geom in spec.geoms}
        geoms = body.geoms if body else []
        spheres = [geom for geom in geoms if geom.type == mujoco.mjtGeom.mjGEOM_SPHERE]
        if foot not in geom_names and len(spheres) == 1:
            spheres[0].name = foot
    return spec


def _place_meshes(spec: Any, path: Path) -> None:
    for mesh in spec.meshes:
        file = mesh_file(path, mesh.file, spec.meshdir)
        if file is not None and file.suffix.lower() in _MESHES:
            mesh.file = str(file)
            continue
        for geom in [geom for geom in spec.geoms if geom.meshname == mesh.name]:
            if not geom.parent.explicitinertial:
                problem = (
                    f"link {geom.parent.name!r} has no <inertial>, "
                    f"and its mesh {mesh.file!r} cannot be read"
                )
                remedy = (
                    "give the link an <inertial>, or put an .stl or .obj at this path below "
                    f"{path.parent} or a folder above it"
                )
                raise ArtifactError(problem, where=path, remedy=remedy)
            spec.delete(geom)
        spec.delete(mesh)


class UserModel:
    """A compiled model file; ``feet`` are names of geoms, links or bodies.

    Raises ArtifactError if the model cannot be compiled, has actuators although
    ``removes_actuators`` is false, has coupled joints or a link with too large a radius of
    gyration, or if its base is not free or fixed as ``is_free`` states.
    """

    def __init__(
        self, path: Path, is_free: bool, removes_actuators: bool, feet: Sequence[str] = ()
    ):
        self._path = path
        try:
            self._model = read_spec(path, is_free, feet).compile()
        except ArtifactError:
            raise
        except Exception as error:  # ValueError, FatalError or MemoryError
            raise cannot_read(path, str(error)) from error

        if self._model.nu and not removes_actuators:
            first = self._model.actuator(0).name
            problem = (
                f"it has {self._model.nu} actuators of its own, the first is {first!r}: "
                "a joint would be driven twice"
            )
            remedy = (
                'delete the <actuator> section, or write actuators = "remove" in the robot\'s file'
            )
            raise self._error(problem, remedy)
        self.num_links = self._model.nbody - 1  # moving bodies
        self.mass = float(np.sum(self._model.body_mass))  # mass of all bodies [kg]
        self._require_base(is_free)
        self._require_plausible()
        roots = int(np.sum(self._model.body_parentid[1:] == 0))
        if roots != 1:
            remedy = "leave the robot alone in its model"
            raise self._error(f"the world holds {roots} bodies", remedy)

    def _require_base(self, is_free: bool) -> None:
        """Raise ArtifactError unless the free joints of the model fit its base.

        Only the first joint of a free base is a free joint. A fixed base has no free joint.
        """
        is_free_joint = self._model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)
        free_joints = np.flatnonzero(is_free_joint).tolist()
        expected_joints = [0] if is_free else []
        if free_joints == expected_joints:
            return
        base = "free, so that only the first joint may be free" if is_free else "fixed"
        remedy = (
            "change base in its file, or add or delete the free joint "
            '(<freejoint/>; URDF: type="floating")'
        )
        raise self._error(f"free joints {free_joints}, but its base is {base}", remedy)

    def _require_plausible(self) -> None:
        """Raise ArtifactError for coupled joints, or a link with too large a radius of gyration."""
        model = self._model
        if model.neq:
            if model.eq_type[0] != mujoco.mjtEq.mjEQ_JOINT:
                remedy = "delete it: loops are not supported; give each leg as an open chain"
                raise self._error("an equality constraint closes a loop", remedy)
            indices = (int(model.eq_obj1id[0]), int(model.eq_obj2id[0]))
            joints = [model.joint(index).name for index in indices if index >= 0]
            coupled = " to ".join(map(repr, joints))
            problem = f"a <mimic> or equality constraint couples joint {coupled}"
            remedy = (
                f"it has no motor of its own: make {joints[0]!r} fixed, "
                "without <mimic> or constraint"
            )
            raise self._error(problem, remedy)

        radius = np.sqrt(model.body_inertia.max(axis=1) / np.maximum(model.body_mass, 1e-12))
        moves = (model.body_mass > 0.0) & (model.body_weldid > 0)
        radius[~moves] = 0.0  # only links that move count
        body = int(radius.argmax())
        bound = max(MAX_GYRATION, MAX_RELATIVE_GYRATION * model.stat.extent)
        if radius[body] > bound:
            name = model.body(body).name
            mass = model.body_mass[body]
            inertia = model.body_inertia[body].max()
            problem = (
                f"link {name!r} has {inertia:.3g} kg·m² and {mass:.3g} kg, "
                f"a radius of gyration of {radius[body]:.3g} m, above {bound:.3g} m"
            )
            raise self._error(problem, "correct its inertia: kg·m², about the centre of mass")

    def _error(self, problem: str, remedy: str) -> ArtifactError:
        return ArtifactError(problem, where=self._path, remedy=remedy)

    def limits(self) -> dict[str, tuple[float, float]]:
        """Lower and upper limits [rad] of the hinges by name, in the model's order.

        Raises ArtifactError for no joint, one of another type, or one without limits.
        """
        limits: dict[str, tuple[float, float]] = {}
        for index in range(self._model.njnt):
            joint_type = self._model.jnt_type[index]
            name = self._model.joint(index).name
            if joint_type == mujoco.mjtJoint.mjJNT_FREE:
                continue
            if joint_type != mujoco.mjtJoint.mjJNT_HINGE or not name:
                problem = f"joint number {index} ({name!r}) is not a hinge with a name"
                remedy = 'name it, or make it fixed (URDF: type="fixed"; MJCF: delete the joint)'
                raise self._error(problem, remedy)
            if not self._model.jnt_limited[index]:
                remedy = (
                    'give it range="LOWER UPPER"; '
                    'in a URDF type="revolute" and <limit lower="…" upper="…"/>'
                )
                raise self._error(f"joint {name!r} has no limits", remedy)
            lower, upper = self._model.jnt_range[index].tolist()
            limits[name] = lower, upper
        if not limits:
            raise self._error("the model has no hinges", "give a model with joints")
        return limits

    def leg_geometry(
        self, joints: tuple[str, ...], foot: str, pose: dict[str, float]
    ) -> tuple[float, float, float, tuple[float, float]]:
        """Thigh, shank and foot radius [m]; the foot's centre forward and left of the base [m].

        The centre is in the pose, joint angles by name [rad].
        """
        geom_names = [self._model.geom(index).name for index in range(self._model.ngeom)]
        if foot not in geom_names:
            names = ", ".join(name for name in geom_names if name) or "none has a name"
            remedy = (
                "give a geom or named <collision>, or a link or body with one sphere; "
                f"geoms with names: {names}"
            )
            raise self._error(f"no foot {foot!r}", remedy)

        geom = self._model.geom(foot).id
        if self._model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_SPHERE:
            raise self._error(f"foot {foot!r} is not a sphere", "give the foot a sphere")

        data = self._data_at(pose)
        hip = data.xanchor[self._model.joint(joints[1]).id]
        knee = data.xanchor[self._model.joint(joints[2]).id]
        centre = data.geom_xpos[geom]
        thigh = float(np.linalg.norm(knee - hip))
        shank = float(np.linalg.norm(centre - knee))
        forward, left, _ = (centre - data.xpos[1]).tolist()
        return thigh, shank, float(self._model.geom_size[geom, 0]), (forward, left)

    def leg_mismatch(self, leg: Leg, names: tuple[str, ...], pose: dict[str, float]) -> str:
        """How the leg of the model differs from `Leg`, in a pose and with a joint moved by 0.1 rad.

        Hip and knee must move the foot as in `Leg.reach`; a growing abduction must move it to the
        left. The text is empty if the leg does not differ.
        """
        step = 0.1
        # Tolerance of the foot's position [m]: larger than the lateral offsets of real legs cause,
        # smaller than the error by a reversed joint.
        tolerance = 0.08 * (leg.thigh + leg.shank)
        abduction, hip, knee = (names[joint] for joint in leg.joints)
        foot = self._model.geom(leg.foot).id
        for moved in (None, hip, knee):
            angles = pose | ({} if moved is None else {moved: pose[moved] + step})
            data = self._data_at(angles)
            forward, _, down = data.geom_xpos[foot] - data.xanchor[self._model.joint(hip).id]
            expected = leg.reach(np.array([angles[name] for name in names]))
            if max(abs(forward - expected[0]), abs(-down - expected[1])) > tolerance:
                where = "in the nominal pose" if moved is None else f"as {moved!r} grows"
                return (
                    f"{where}, foot {leg.foot!r} is {forward:.3f} m forward of and {-down:.3f} m "
                    f"below its hip; expected {expected[0]:.3f} and {expected[1]:.3f} m "
                    "(hip, knee about +y, straight at 0)"
                )

        abducted_pose = pose | {abduction: pose[abduction] + step}
        y_abducted = self._data_at(abducted_pose).geom_xpos[foot, 1]
        y_in_pose = self._data_at(pose).geom_xpos[foot, 1]
        if y_abducted <= y_in_pose:
            return (
                f"foot {leg.foot!r} moves right as {abduction!r} grows; "
                "an abduction about +x moves it left"
            )
        return ""

    def standing_height(self, pose: dict[str, float], feet: list[str]) -> float:
        """Height of the base at which the lowest foot touches the ground [m]."""
        data = self._data_at(pose)
        geoms = [self._model.geom(name).id for name in feet]
        bottoms = [data.geom_xpos[geom, 2] - self._model.geom_size[geom, 0] for geom in geoms]
        return float(data.xpos[1, 2] - min(bottoms))  # body 1 is the base

    def load_inertia(self, pose: dict[str, float], legs: int, height: float) -> tuple[float, float]:
        """Range of the load inertia of a motor [kg·m²].

        The lower end is 0.3 times the smallest inertia of a joint, the diagonal element of the mass
        matrix. The upper end is 1.5 times the largest inertia of a joint or of a leg; the inertia
        of a leg is the robot's mass per leg times the squared height of the base. The factors 0.3
        and 1.5 are margins.
        """
        data = self._data_at(pose)
        joint_inertia = []
        column = np.zeros(self._model.nv)
        unit_vectors = np.eye(self._model.nv)
        mujoco.mj_forward(self._model, data)
        for joint in range(self._model.nv - len(pose), self._model.nv):
            mujoco.mj_mulM(self._model, data, column, unit_vectors[joint])  # a column of the matrix
            joint_inertia.append(float(column[joint] - self._model.dof_armature[joint]))
        inertia_per_leg = self.mass / legs * height**2 if legs else 0.0
        return 0.3 * min(joint_inertia), 1.5 * max(*joint_inertia, inertia_per_leg)

    def _data_at(self, pose: dict[str, float]):
        data = mujoco.MjData(self._model)
        for name, angle in pose.items():
            data.joint(name).qpos[0] = angle
        mujoco.mj_kinematics(self._model, data)
        return data
