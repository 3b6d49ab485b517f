"""Equal joints of several legs or sides are one class, by their names."""

import pytest

from motorprior.robots.joint_classes import classes_by_name, position_classes


@pytest.mark.parametrize(
    ("names", "classes"),
    [
        (("FL_hip_joint", "FL_calf_joint", "RR_hip_joint", "RR_calf_joint"), ("hip", "calf") * 2),
        (("LF_HAA", "LF_KFE", "RH_HAA", "RH_KFE"), ("haa", "kfe") * 2),
        (
            ("leftKnee", "rightKnee", "left_hip_yaw", "right_hip_yaw"),
            ("knee", "knee", "hip yaw", "hip yaw"),
        ),
        (("joint1", "joint2", "joint3"), ("",) * 3),
        (("Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll", "Jaw"), ("",) * 6),
        (("l_knee", "r_knee", "l_hip", "r_hip", "waist"), ("knee", "knee", "hip", "hip", "waist")),
        (("l_knee", "waist", "neck"), ("",) * 3),
    ],
)
def test_the_class_of_a_joint_is_its_name_without_side_and_number(
    names: tuple[str, ...], classes: tuple[str, ...]
):
    assert classes_by_name(names) == classes


@pytest.mark.parametrize(
    ("names", "described", "classes"),
    [
        (("FL_calf_joint", "FR_calf_joint"), ("M8010",) * 2, ("calf", "calf")),
        (("joint1", "joint2", "joint3"), ("upper", "lower", "lower"), ("upper", "lower", "lower")),
        (("joint1", "joint2"), ("M8010",) * 2, ("joint1", "joint2")),
        (("joint1", "joint2"), (), ("joint1", "joint2")),
    ],
)
def test_positions_are_in_the_names_or_else_described(
    names: tuple[str, ...], described: tuple[str, ...], classes: tuple[str, ...]
):
    assert position_classes(names, described) == classes
