"""Fields of parsed JSON: every refusal names file, field, what was given and what is allowed."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception import FileFormatError, MissingFile
from guara_perception.fields import Fields, read_json
from tests.thorough import examples

SOURCE = "some.json"


def fields(**values: object) -> Fields:
    return Fields(values, SOURCE, "entry")


def refusal(read) -> str:
    with pytest.raises(FileFormatError) as caught:
        read()
    return str(caught.value)


def test_missing_file_is_named(tmp_path: Path):
    """A file that is not there is named."""
    with pytest.raises(MissingFile, match="nothing.json: no such file"):
        read_json(tmp_path / "nothing.json")


def test_folder_in_place_of_a_file_is_refused(tmp_path: Path):
    """A folder of that name is no file."""
    with pytest.raises(MissingFile, match="is a folder; give the file in it"):
        read_json(tmp_path)


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"not json", b"\xff\xfe\x00", b'{"a": ' + b"9" * 5000 + b"}", b"[" * 100_000],
    ids=["empty", "cut", "text", "not utf-8", "5000 digits", "too deep"],
)
def test_what_is_not_json_is_refused_with_its_name(tmp_path: Path, content: bytes):
    """Damage of any kind ends in one error that names the file, never in an error of the parser."""
    path = tmp_path / "broken.json"
    path.write_bytes(content)
    assert "broken.json: not a JSON file" in refusal(lambda: read_json(path))


@pytest.mark.parametrize("content", ["[]", "1", '"text"', "null"])
def test_top_level_must_be_an_object(tmp_path: Path, content: str):
    """Only an object has fields."""
    path = tmp_path / "list.json"
    path.write_text(content)
    assert "it must be a JSON object" in refusal(lambda: read_json(path))


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_not_finite_numbers_are_refused_wherever_they_are(tmp_path: Path, number: str):
    """NaN is found in fields that nobody reads too, and its path is named."""
    path = tmp_path / "deep.json"
    path.write_text(f'{{"a": [1, {{"b": [2, {number}]}}]}}')
    message = refusal(lambda: read_json(path))
    assert "deep.json: a[1].b[1] is" in message and "must be finite" in message


@pytest.mark.slow
@settings(max_examples=examples(50), derandomize=True)
@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
        max_leaves=20,
    )
)
def test_every_finite_object_is_read_as_it_was_written(tmp_path_factory: pytest.TempPathFactory, value: object):
    """What JSON can hold and is finite comes back the same."""
    path = tmp_path_factory.getbasetemp() / "any.json"
    path.write_text(json.dumps({"value": value}))
    assert read_json(path).data == {"value": value}


@pytest.mark.parametrize("reader", ["raw", "text", "integer", "number", "sub", "sequence"])
def test_missing_and_null_are_distinguished(reader: str):
    """A field that is not there is missing; one that is null is reported as null."""
    assert refusal(lambda: getattr(fields(), reader)("x")) == "some.json: entry.x is missing"
    assert refusal(lambda: getattr(fields(x=None), reader)("x")) == "some.json: entry.x is null; a value is needed"


def test_has_is_false_for_null():
    """`has` means that there is a value."""
    assert fields(x=0).has("x")
    assert not fields(x=None).has("x")
    assert not fields().has("x")


@pytest.mark.parametrize(
    ("reader", "value", "reported"),
    [
        ("text", 1, "is a whole number; it must be text"),
        ("integer", 1.5, "is a number; it must be a whole number"),
        ("integer", True, "is true or false; it must be a whole number"),
        ("integer", "1", "is text; it must be a whole number"),
        ("number", "1", "is text; it must be a number"),
        ("number", False, "is true or false; it must be a number"),
        ("number", float("nan"), "is nan; it must be finite"),
        ("number", 10**400, "is inf; it must be finite"),
        ("sub", [], "is a list; it must be an object"),
        ("sequence", {}, "is an object; it must be a list"),
    ],
)
def test_wrong_kind_is_named(reader: str, value: object, reported: str):
    """The message says what kind of value was given and what kind is needed."""
    assert refusal(lambda: getattr(fields(x=value), reader)("x")) == f"some.json: entry.x {reported}"


def test_text_lists_what_is_allowed():
    """A text that is not among those allowed is shown beside them."""
    assert refusal(lambda: fields(x="c").text("x", ("a", "b"))) == "some.json: entry.x is 'c', allowed: 'a', 'b'"
    assert fields(x="a").text("x", ("a", "b")) == "a"


@settings(max_examples=examples(60), derandomize=True)
@given(st.integers(-100, 100), st.integers(-50, 0), st.integers(0, 50))
def test_bounds_are_inclusive(value: int, low: int, high: int):
    """A number is accepted exactly when low <= value <= high."""
    reader = fields(x=value)
    if low <= value <= high:
        assert reader.integer("x", low, high) == value
        assert reader.number("x", low, high) == value
    else:
        for read in (reader.integer, reader.number):
            assert f"allowed: {low} ... {high}" in refusal(lambda read=read: read("x", low, high))


def test_open_bounds_are_shown_as_infinite():
    """A bound that is not given is shown as infinity."""
    assert "allowed: 0 ... inf" in refusal(lambda: fields(x=-1).integer("x", minimum=0))
    assert "allowed: -inf ... 3" in refusal(lambda: fields(x=4).number("x", maximum=3))


def test_array_has_the_shape_that_was_asked_for():
    """A nested list becomes an array of that shape; None stands for any length."""
    array = fields(x=[[1, 2], [3, 4], [5, 6.5]]).array("x", (None, 2))
    np.testing.assert_array_equal(array, [[1, 2], [3, 4], [5, 6.5]])
    assert array.dtype == np.float64


@pytest.mark.parametrize(
    ("value", "reported"),
    [
        ([1, 2], "has shape 2; it must be 3"),
        (5, "is a single number; it must be an array of 3 numbers"),
        ([[1, 2, 3]], "has shape 1x3; it must be 3"),
        ([1, [2], 3], "is not an array of 3 numbers"),
        (["1", "2", "3"], "is not an array of 3 numbers"),
        ([True, False, True], "is not an array of 3 numbers"),
        ([1, None, 3], "is not an array of 3 numbers"),
        ([1, {}, 3], "is not an array of 3 numbers"),
        ([1, 10**400, 3], "is not an array of 3 numbers"),
        ([1, float("nan"), 3], "holds NaN or infinity; all values must be finite"),
    ],
)
def test_bad_arrays_are_refused(value: object, reported: str):
    """Other shapes, texts, truth values, gaps and NaN are no array of numbers."""
    assert refusal(lambda: fields(x=value).array("x", (3,))) == f"some.json: entry.x {reported}"


def test_nested_fields_are_named_by_their_path():
    """Objects in objects and lists know their path."""
    top = Fields({"a": {"b": [{"c": 1}, {"c": "x"}, 7]}}, SOURCE)
    items = top.sub("a").items("b")
    assert next(items).integer("c") == 1
    second = next(items)
    assert refusal(lambda: second.integer("c")).startswith("some.json: a.b[1].c is text")
    assert refusal(lambda: next(items)) == "some.json: a.b[2] is a whole number; it must be an object"
