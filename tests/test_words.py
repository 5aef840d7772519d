"""Plain words: phrases that a reader stumbles over stay out, and types of arrays have one name each."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("kinematics", "drivers", "transport", "guara_perception")
# What is refused -> what to write instead.
REFUSED = {
    r"(?i:(?:\b|_)told(?:\b|_))": "say who reports, shows or names it",
    r"\buntold\b": "name the mask, e.g. is_unknown",
    r"\b[Ss]o (?:many|much)\b": "name the number, say what it counts, or write this many",
    r"\b(?:[Ff]or|by) so long\b": "name the number, or say what it counts",
    r"\bthat[ _](?:is|are)[ _]none\b(?! of)": "say that it is not valid",
    r"\banew\b": "again, or from the start",
    r"\b(?:thereof|hence|thence|whilst|amongst)\b": "of it, so, from there, while, among",
    r"\bparted by\b": "separated by",
    r"\bhowever one leaves\b": "say by which way",
    r"\bdelay who\b": "delay whoever, or name it",
    r"\bworths\b": "weights",
    r"\bway_[xy]\b": "offset",
    r"\beyes\b(?! with| that)": "sensor origins",
    r"\b(?:laser'?s? )?sheets?\b(?=[ .,;]+(?:of light|falls|meets|on_floor))": "laser plane",
    r"\bheight gates\b": "height limits",
    r"\b(?:spread(?=\(| =|, )|\w+_spread\b)": "sigma, variance, scatter or extent",
    r"\bmiddles\b": "medians or centres",
    r"\b[Hh]armless when\b": "does nothing when",
    r"\b[Ww]hat (?:came|became) of\b": "the result of",
    # An entry of Args or Attributes.
    r"(?m:^ {4,}\w+(?:, \w+)*: of )": "say what it is: `name: name of the robot`",
}
# Names that a variable, an argument, an attribute or a function must not have -> what to write instead. Allowed is
# `place` as a row of the table of steps in the laser board's protocol, and as in `guara security router --place`.
REFUSED_NAMES = {
    "place": "index, position, pose, slot or path",
    "places": "indices, positions or poses",
    "spread": "sigma, variance, scatter or extent",
    "untold": "is_unknown",
    "words": "text, message, arguments, command, expected_text",
    "ours": "what it is: estimate, sent, computed",
    "theirs": "what it is: received, other",
    "middle": "centre, mean, median or the index of it",
    "sheet": "laser_plane",
}
NAMES_ALLOWED = {
    "place": (
        "drivers/board_sweep.py",
        "drivers/emulator/sweep.py",
        "drivers/sweep_proof.py",
        "drivers/sweep_records.py",
        "drivers/sweep_worker.py",
        "tests/drivers/test_triggered_sweep.py",
        "tests/firmware/test_conformance_sweep.py",
        "guara_perception/app/commands/security.py",
        "tests/transport/security/test_router_folder.py",
        "transport/security/router_folder.py",
    ),
    # Of paper, in what is printed.
    "sheet": (
        "guara_perception/app/commands/targets.py",
        "guara_perception/app/targets/sheet.py",
        "guara_perception/app/targets/write.py",
        "tests/guara_perception/app/targets/test_targets.py",
    ),
    "places": ("drivers/emulator/sweep.py", "tests/guara_perception/terrain/questions/test_foothold.py"),
}
# Of the optics of eyes and of light, not of sensors and figures.
ALLOWED = {"colour-blind eyes"}


def texts() -> list[Path]:
    """Every file of the packages, examples and documents that a user may read."""
    folders = (*PACKAGES, "benchmarks", "examples", "docs", "firmware", "robots", "tests")
    found = [
        path
        for folder in folders
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".py", ".md", ".toml") and "node_modules" not in path.parts and path != Path(__file__)
    ]
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *found]


@cache
def suspects() -> dict[Path, str]:
    """Texts in which any of the phrases stands: few, so that each phrase need not be sought in all."""
    # Those that begin with a word, or a part of a name, are sought only there.
    of_lines = [phrase for phrase in REFUSED if phrase.startswith("(?m:^")]
    of_words = [phrase for phrase in REFUSED if phrase.startswith((r"\b", r"(?:\b|_)", r"(?i:(?:\b|_)"))]
    assert sorted((*of_lines, *of_words)) == sorted(REFUSED)
    any_of_them = re.compile("|".join((*of_lines, r"(?:\b(?=\w)|(?=_))(?:" + "|".join(of_words) + ")")))
    read = {path: path.read_text(encoding="utf-8") for path in texts()}
    return {path: text for path, text in read.items() if any_of_them.search(text)}


@pytest.mark.slow
@pytest.mark.parametrize("phrase", REFUSED)
def test_no_file_holds_a_refused_phrase(phrase: str):
    """Each line is shown with what to write instead."""
    found = []
    for path, text in suspects().items():
        for number, line in enumerate(text.splitlines(), 1):
            for word in ALLOWED:
                line = line.replace(word, "")
            if re.search(phrase, line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()}")
    assert not found, f"write instead: {REFUSED[phrase]}\n" + "\n".join(found)


def test_phrases_are_found():
    """The expressions refuse what they were made for."""
    for line in ("it is told so", "so many rows", "a covariance that is none", "the eyes see", "the sheet falls"):
        assert any(re.search(phrase, line) for phrase in REFUSED), line


def names(tree: ast.AST) -> set[str]:
    """Everything that a module names itself, or calls by name."""
    found = set()
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name) | ast.keyword(arg=str(name)):
                found.add(name.strip("_"))
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                found.add(name.strip("_"))
    return found


@pytest.mark.slow
def test_no_name_is_a_word_of_several_meanings():
    """What was one word for an index, a position, a pose and a folder is called by which of them it is."""
    any_of_them = re.compile(rf"\b_?(?:{'|'.join(REFUSED_NAMES)})\b")
    found = []
    for folder in (*PACKAGES, "benchmarks", "examples", "firmware", "tests"):
        for path in (ROOT / folder).rglob("*.py"):
            file, text = path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")
            if not any_of_them.search(text):
                continue
            for name in sorted(names(ast.parse(text)) & REFUSED_NAMES.keys()):
                if file not in NAMES_ALLOWED.get(name, ()):
                    found.append(f"{file}: {name}; write instead: {REFUSED_NAMES[name]}")
    assert not found, "\n".join(found)


def test_names_are_found():
    """Arguments, attributes, keywords, loops and functions count; words of prose do not."""
    for line in ("def f(place): ...", "f(place=1)", "a._place = 1", "for place in a: ...", "def place(): ..."):
        assert "place" in names(ast.parse(line)), line
    assert "place" not in names(ast.parse('"""In place of it."""'))


def aliases(path: Path) -> list[str]:
    """Names that a file gives to types of arrays."""
    named: list[str] = []
    text = path.read_text(encoding="utf-8")
    if "NDArray[" not in text:
        return named
    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and "NDArray[" in ast.unparse(node):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            named += [ast.unparse(target) for target in targets]
    return named


def test_array_types_are_named_in_arrays_alone():
    """One module of each package holds the names; others import them."""
    found = {
        str(path.relative_to(ROOT)): names
        for package in (*PACKAGES, "benchmarks")
        for path in (ROOT / package).rglob("*.py")
        if path.name != "arrays.py" and (names := aliases(path))
    }
    assert not found
    assert all(aliases(ROOT / package / "arrays.py") for package in PACKAGES)
