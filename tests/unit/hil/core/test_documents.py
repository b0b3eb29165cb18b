"""Documents: what is refused, and that every refusal names the source, the key and the value."""

from __future__ import annotations

import json
import math
from typing import Annotated, Literal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.documents import DEEPEST_NESTING, Document, from_json, from_plain, from_toml, to_json
from hil.core.errors import DocumentError


class Leaf(Document, frozen=True):
    size: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)]
    count: Annotated[int, msgspec.Meta(ge=1)] = 1
    unit: Literal["m", "rad"] = "m"


class Round(Document, frozen=True, tag_field="kind", tag="round"):
    radius: float


class Square(Document, frozen=True, tag_field="kind", tag="square"):
    side: float
    corner: Literal["sharp", "blunt"] = "sharp"


class Tree(Document, frozen=True):
    leaves: Annotated[dict[str, Leaf], msgspec.Meta(max_length=3)]
    rows: list[list[float]] = msgspec.field(default_factory=list)
    shape: Round | Square = Round(1.0)
    version: Literal[1] = 1


def refusal(plain: object) -> str:
    with pytest.raises(DocumentError) as caught:
        from_plain(plain, Tree, "tree.toml")
    return str(caught.value)


LEAF = {"size": 1.0}


@pytest.mark.parametrize(
    ("plain", "text"),
    [
        ({"leaves": {"a": {"size": 11.3}}}, "leaves.a.size: 11.3: expected `float` <= 10.0"),
        ({"leaves": {"a": {"size": -0.1}}}, "leaves.a.size: -0.1: expected `float` >= 0.0"),
        ({"leaves": {"a": {"size": "big"}}}, "leaves.a.size: 'big': expected `float`, got `str`"),
        ({"leaves": {"a": LEAF, "b": {"size": 12}}}, "leaves.b.size: 12: expected `float` <= 10.0"),
        (
            {"leaves": {"a": LEAF | {"count": 1}, "b": {}}},
            "leaves.b: object missing required field `size`",
        ),
        ({"leaves": {"a": LEAF | {"unit": "cm"}}}, "leaves.a.unit: 'cm': must be 'm' or 'rad'"),
        ({"leaves": {"a": LEAF | {"siz": 1}}}, "leaves.a: object contains unknown field `siz`"),
        ({"leaves": {}, "leafs": {}}, "object contains unknown field `leafs`"),
        ({}, "object missing required field `leaves`"),
        ([], "expected `object`, got `array`"),
        ({"leaves": 3}, "leaves: 3: expected `object`, got `int`"),
        ({"leaves": dict.fromkeys("abcd", LEAF)}, "leaves: expected `object` of length <= 3"),
        ({"leaves": {}, "rows": [[1.0], [2.0, "x"]]}, "rows[1][1]: 'x': expected `float`, got `str`"),
        ({"leaves": {}, "version": 2}, "version: 2: must be 1"),
        (
            {"leaves": {}, "shape": {"kind": "oval"}},
            "shape.kind: 'oval': must be 'round' or 'square'",
        ),
        (
            {"leaves": {}, "shape": {"kind": "square", "side": 1, "corner": "red"}},
            "shape.corner: 'red': must be 'blunt' or 'sharp'",
        ),
        (
            {"leaves": {}, "shape": {"kind": "round", "side": 1}},
            "shape: object contains unknown field `side`",
        ),
        # Not a number is not a number wherever it stands.
        ({"leaves": {"a": {"size": math.nan}}}, "leaves.a.size: nan is not a finite number"),
        ({"leaves": {}, "rows": [[1.0], [math.inf]]}, "rows[1][0]: inf is not a finite number"),
        ({"leaves": {}, "rows": [[-math.inf]]}, "rows[0][0]: -inf is not a finite number"),
        ({"leaves": {"a": LEAF | {"count": 2**63}}}, "leaves.a.count: an integer beyond 64 bits"),
        ({"leaves": {"a": {"size": -(10**5000)}}}, "leaves.a.size: an integer beyond 64 bits"),
        # Keys that look like msgspec's own paths.
        ({"leaves": {"...": {"size": 11}}}, "leaves.....size: 11: expected `float` <= 10.0"),
        ({"leaves": {"0": {"size": 11}}}, "leaves.0.size: 11: expected `float` <= 10.0"),
        ({"leaves": {"a.b": LEAF, "a": {"b": 11}}}, "leaves.a: object contains unknown field `b`"),
    ],
)
def test_refusals_name_source_path_value_and_limit(plain: object, text: str) -> None:
    assert refusal(plain) == f"tree.toml: {text}"


def test_the_place_is_right_where_two_tables_have_the_same_mistake() -> None:
    assert refusal({"leaves": {"a": {"size": 12}, "b": {"size": 12}}}) == (
        "tree.toml: leaves.a.size: 12: expected `float` <= 10.0"
    )


@pytest.mark.parametrize(
    "key", ["x - at `$.leaves.size.x", "x - at `$.leaves[...].size", "x - at `$[4]", "x - at `$.no[...]"]
)
def test_a_key_that_imitates_a_path_is_still_refused(key: str) -> None:
    assert refusal({"leaves": {"a": LEAF}, key: 1}).startswith("tree.toml: ")


def test_a_toml_date_is_refused_where_it_stands() -> None:
    with pytest.raises(DocumentError, match=r"t: leaves\.a\.unit: .*expected `str`, got `date`"):
        from_toml("[leaves.a]\nsize = 1\nunit = 1979-05-27", Tree, "t")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("leaves = ", "Invalid value (at end of document)"),
        ("[leaves]\n[leaves]\n", "line 2"),
        ("rows = " + "9" * 5000, "limit"),
        ("rows = " + "[" * 5000, "nested too deeply"),
    ],
)
def test_text_that_is_not_toml(text: str, said: str) -> None:
    with pytest.raises(DocumentError, match=r"^t: not valid TOML: ") as caught:
        from_toml(text, Tree, "t")
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"leaves": }', "line 1 column 12"),
        ("", "Expecting value"),
        ('{"rows": ' + "9" * 5000 + "}", "limit"),
        ('{"rows": ' + "[" * 100_000, "nested too deeply"),
    ],
)
def test_text_that_is_not_json(text: str, said: str) -> None:
    with pytest.raises(DocumentError, match=r"^t: not valid JSON: ") as caught:
        from_json(text, Tree, "t")
    assert said in str(caught.value)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999"])
def test_json_numbers_that_are_not_finite_are_refused_by_key(number: str) -> None:
    with pytest.raises(DocumentError, match=r"^t: rows\[0\]\[0\]: -?(nan|inf) is not a finite number$"):
        from_json(f'{{"leaves": {{}}, "rows": [[{number}]]}}', Tree, "t")


@pytest.mark.parametrize(("depth", "said"), [(DEEPEST_NESTING, "expected `float`"), (900, "nested deeper")])
def test_deep_nesting_is_refused_before_it_can_exhaust_the_stack(depth: int, said: str) -> None:
    rows: object = 1.0
    for _ in range(depth - 1):
        rows = [rows]
    assert said in refusal({"leaves": {}, "rows": rows})


plain_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.dates()
    | st.sampled_from(["m", "rad", "round", 1, 1.0]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["leaves", "size", "rows", "shape", "kind", "...", "radius", "unit"])
            | st.text(max_size=4),
            inner,
            max_size=4,
        )
    ),
    max_leaves=12,
)


@given(plain_values)
def test_anything_at_all_is_read_or_refused(plain: object) -> None:
    try:
        tree = from_plain({"leaves": plain}, Tree, "t")
    except DocumentError as error:
        assert str(error).startswith("t: ")
    else:
        assert isinstance(tree, Tree)


sizes = st.floats(0.0, 10.0)
leaves = st.builds(Leaf, size=sizes, count=st.integers(1, 2**62), unit=st.sampled_from(["m", "rad"]))
finite = st.floats(allow_nan=False, allow_infinity=False)
trees = st.builds(
    Tree,
    leaves=st.dictionaries(st.text(max_size=4), leaves, max_size=3),
    rows=st.lists(st.lists(finite, max_size=3), max_size=3),
    shape=st.builds(Round, radius=finite) | st.builds(Square, side=finite),
)


@given(trees)
def test_json_is_read_back_to_an_equal_object(tree: Tree) -> None:
    text = to_json(tree)
    assert from_json(text, Tree, "t") == tree
    assert text.endswith("}\n") and json.loads(text)["version"] == 1


def test_documents_are_frozen() -> None:
    leaf = Leaf(size=1.0)
    with pytest.raises(AttributeError):
        leaf.size = 2.0  # type: ignore[misc]
