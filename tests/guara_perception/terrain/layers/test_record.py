"""Records of grids: JSON keys and their order are kept; unreadable values are rejected when they are needed."""

import copy
import dataclasses
import json
import pickle

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.record import FORMS, GridRecord, Health
from tests import frozen

each_kind = pytest.mark.parametrize("kind", (gp.ScanRecord, gp.MapRecord))


@pytest.mark.parametrize("name", frozen.GRIDS)
def test_a_changed_record_keeps_keys_their_order_and_every_other_value(name: str) -> None:
    """After a change, keys, their order and all other values are those that were read."""
    record = frozen.frozen(name).record
    again = dataclasses.replace(record, epoch="walk")
    assert list(again.to_json()) == [*record.to_json(), "epoch"]
    assert json.dumps(dict(again.to_json())) == json.dumps({**record.to_json(), "epoch": "walk"})
    for other in (pickle.loads(pickle.dumps(again)), copy.deepcopy(again)):
        assert other.to_json() == again.to_json()


@each_kind
def test_a_new_record_has_the_order_of_its_kind(kind: type[GridRecord]) -> None:
    """For any order of its fields; null where it is given."""
    record = kind(
        epoch="a", robot="guara", health=Health("failed", ("x",)), extra={"calibration_verdict": None, "mine": 1}
    )
    assert [*record.to_json()] == [
        n for n in kind.ORDER if n in ("calibration_verdict", "epoch", "health", "robot")
    ] + ["mine"]
    assert record.to_json()["health"] == {"level": "failed", "reasons": ["x"]}
    assert record.to_json()["calibration_verdict"] is None


@each_kind
def test_every_field_has_a_place_and_a_form(kind: type[GridRecord]) -> None:
    """Every field has a place in the JSON object and a reader."""
    named = {entry.name for entry in dataclasses.fields(kind)} - {"extra", "keys", "newer_limits"}
    assert named == set(kind.ORDER) and len(kind.ORDER) == len(named)
    assert all(kind.form_of(name) in FORMS for name in named)


@each_kind
def test_a_value_that_cannot_be_read_is_kept_and_refused(kind: type[GridRecord]) -> None:
    """For every field: the value is kept unchanged in `extra`, and `check` rejects it."""
    for name in kind.ORDER:
        record = kind.from_json({name: {"a": [{}, "b"]} if "Mapping" not in kind.form_of(name) else 3})
        if kind.form_of(name) == "Health | None":
            continue
        assert getattr(record, name) is None and [*record.extra] == [name]
        for refused in ([name], []):
            with pytest.raises(gp.InvalidInput, match=f"has {name} = .*; allowed: "):
                record.check(*refused)
        assert [*dataclasses.replace(record, keys=()).to_json()] == [name]
        dataclasses.replace(record, extra={}).check()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("transform_base_to_footprint", np.full((4, 4), np.nan).tolist()),
        ("pose_covariance", np.eye(3).tolist()),
        ("validity_pauses", True),
        ("validity_seconds", "420"),
        ("lost_cells", [[1, 2]]),
        ("stance", {"joint_positions": {}}),
        ("health", {"reasons": "blank"}),
        ("provisional", 1),
        ("limits", {"slope": 0.3}),
    ],
)
def test_values_of_the_wrong_form_are_not_read(name: str, value: object) -> None:
    """Numbers are no truth values; matrices have their shape and are finite."""
    record = gp.ScanRecord.from_json({name: value})
    with pytest.raises(gp.InvalidInput, match=name):
        record.check(name)


def test_a_record_cannot_be_changed() -> None:
    """Neither by attribute, nor in its arrays and mappings, nor through the view."""
    record = frozen.frozen("walk").record
    with pytest.raises(dataclasses.FrozenInstanceError):
        record.robot = "other"  # type: ignore[misc]
    assert record.pose_covariance is not None and not record.pose_covariance.flags.writeable
    assert record.support_soles and not any(sole.flags.writeable for sole in record.support_soles.values())
    for mapping in (record.hazard_cells, record.to_json()):
        with pytest.raises(TypeError):
            mapping["STEP"] = 0  # type: ignore[index]
