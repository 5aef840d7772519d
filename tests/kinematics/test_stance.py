import pickle

import pytest

from kinematics import KinematicsError, Stance, StanceError

GOOD = {"joint_positions": {"a": 0.1, "b": -1}, "support_feet": ["lf", "rf"], "gravity_in_base": [0.0, 0.1, -9.81]}


def test_json_form_survives_the_round_trip() -> None:
    """A stance converted to JSON and back is equal, with and without gravity."""
    for gravity in (None, [0.0, 0.1, -9.81]):
        stance = Stance.from_dict({**GOOD, "gravity_in_base": gravity})
        assert Stance.from_dict(stance.to_dict()) == stance


def test_pickle_survives_the_round_trip() -> None:
    """A pickled stance is equal after loading."""
    stance = Stance.from_dict(GOOD)
    assert pickle.loads(pickle.dumps(stance)) == stance


def test_gravity_may_be_left_out() -> None:
    """A missing gravity_in_base means unknown, like null."""
    assert Stance.from_dict({k: GOOD[k] for k in ("joint_positions", "support_feet")}).gravity_in_base is None


def test_values_are_read_only() -> None:
    """Neither stance nor joints can be changed, and changing the given dictionary does not affect the stance."""
    given = {"a": 0.1}
    stance = Stance(given, ("lf",))
    given["a"] = 5.0
    assert stance.joint_positions["a"] == 0.1
    with pytest.raises(TypeError):
        stance.joint_positions["a"] = 1.0  # type: ignore[index]
    with pytest.raises(AttributeError):
        stance.support_feet = ()  # type: ignore[misc]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint_positions": {"a": float("nan")}}, "stance.joint_positions.a: nan is not finite"),
        ({"joint_positions": {"a": "x"}}, "stance.joint_positions.a: 'x' is not a number"),
        ({"joint_positions": {"a": True}}, "stance.joint_positions.a: True is not a number"),
        ({"joint_positions": [1, 2]}, "stance.joint_positions: [1, 2] is not a mapping"),
        ({"joint_positions": {1: 0.0}}, "stance.joint_positions: 1 is not a joint name"),
        ({"support_feet": "lf"}, "stance.support_feet: 'lf' is not a list"),
        ({"support_feet": ["lf", 3]}, "stance.support_feet: 3 is not a leg name"),
        ({"support_feet": ["lf", "lf"]}, "stance.support_feet: 'lf' is named 2 times"),
        ({"gravity_in_base": [0, 0]}, "stance.gravity_in_base: 2 numbers given; three are needed"),
        ({"gravity_in_base": [0, 0, float("inf")]}, "stance.gravity_in_base: inf is not finite"),
        ({"gravity_in_base": 9.81}, "stance.gravity_in_base: 9.81 is not a list"),
        ({"gravity_in_base": [0, 0, 9.81]}, "accelerometer at rest reads the negative"),
        ({"gravity_in_base": [1, 0, 0]}, "gravity points down (z < 0"),
        ({"gravity": [0, 0, -1]}, "stance.gravity: unknown field; a stance has the fields joint_positions"),
    ],
)
def test_bad_fields_are_named(change: dict, message: str) -> None:
    """Every invalid value is rejected with a message that names its field."""
    with pytest.raises(StanceError) as caught:
        Stance.from_dict({**GOOD, **change})
    assert message in str(caught.value)
    assert isinstance(caught.value, KinematicsError) and isinstance(caught.value, ValueError)


@pytest.mark.parametrize("field", ["joint_positions", "support_feet"])
def test_missing_fields_are_named(field: str) -> None:
    """A missing field is named together with its object."""
    with pytest.raises(StanceError, match=f"stance_end.{field} is missing"):
        Stance.from_dict({k: v for k, v in GOOD.items() if k != field}, field="stance_end")


def test_something_else_than_an_object_is_refused() -> None:
    """A stance that is not an object is rejected."""
    with pytest.raises(StanceError, match="stance: 3 is not an object"):
        Stance.from_dict(3)  # type: ignore[arg-type]
