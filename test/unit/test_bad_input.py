"""Whatever a person or a file gives: an answer, or one line with the file; no traceback ever."""

from __future__ import annotations

import copy
import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from dfm_stage.__main__ import main
from dfm_stage.control.parameter_file import read_parameters
from dfm_stage.errors import DfmError
from dfm_stage.model import load_model
from dfm_stage.recording import read_record
from dfm_stage.trajectory import load_experiment

CONFIG = Path(__file__).parents[2] / "config"
MODELS = sorted((CONFIG / "models").glob("*.yaml"))
EXPERIMENTS = sorted((CONFIG / "experiments").glob("*.yaml"))
PARAMETERS = sorted(CONFIG.glob("*_ax*s.yaml"))
SHORTEST_S = 1e-3

numbers = st.sampled_from([0, 1, -1, 0.0, -0.0, 1e-320, 1e308, -1e308, 2**31, 2**63, 2**200,
                           -2**70, float("nan"), float("inf"), -float("inf"), True, False])
words = st.sampled_from(["", " ", "x", "nan", "1e3", "null", "../..", "/", "\0", "é\n", "{", "!!x",
                         "!!python/object/apply:os.system", "a" * 300, "0x10", "1_000", "12:30:45",
                         "2001-01-01", "\ud800"[:0], "multisine", "paper_stage"])
junk = st.recursive(
    st.none() | numbers | words,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=5)
places = st.lists(st.integers(0, 10**6), min_size=1, max_size=3)


def nodes(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every (container, key) of a tree of plain lists and dicts."""
    items = tree.items() if isinstance(tree, dict) else (
        enumerate(tree) if isinstance(tree, list) else ())
    for key, value in list(items):
        yield tree, key
        yield from nodes(value)


def plain(path: Path) -> Any:
    return json.loads(json.dumps(YAML(typ="safe").load(path.read_text(encoding="utf-8"))))


def mutate(tree: Any, data: st.DataObject) -> Any:
    """Replace, remove, add or rename up to three nodes."""
    tree = copy.deepcopy(tree)
    for _ in range(data.draw(st.integers(1, 3))):
        every = list(nodes(tree))
        if not every:
            return data.draw(junk)
        container, key = every[data.draw(st.integers(0, len(every) - 1))]
        kind = data.draw(st.sampled_from(["replace", "replace", "remove", "add", "rename"]))
        if kind == "replace":
            container[key] = data.draw(junk)
        elif kind == "remove":
            del container[key]
        elif isinstance(container, list):
            container.append(data.draw(junk))
        elif kind == "add":
            container[data.draw(words)] = data.draw(junk)
        else:
            container[data.draw(words)] = container.pop(key)
    return tree


def text_of(tree: Any) -> str:
    """JSON is YAML; with YAML's words for what JSON has none for."""
    text = json.dumps(tree, allow_nan=True)
    return text.replace("-Infinity", "-.inf").replace("Infinity", ".inf").replace("NaN", ".nan")


def damage(text: str, data: st.DataObject) -> bytes:
    """Change, drop or insert some bytes."""
    raw = bytearray(text.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(raw)))
        size = data.draw(st.integers(0, 8))
        raw[at:at + size] = data.draw(st.binary(max_size=6) | st.sampled_from(
            [b"\t", b"\n", b":", b"- ", b"&a ", b"*a ", b"!!x ", b"\xff", b"\0", b"{", b"%"]))
    return bytes(raw)


def one_line(error: DfmError, *parts: str) -> None:
    text = str(error)
    assert text.strip(), "an empty message"
    assert "\n" not in text, text
    assert len(text) < 1000, text
    for part in parts:
        assert part in text, (part, text)


def draw_yaml(files: list[Path], data: st.DataObject, folder: Path) -> Path:
    source = data.draw(st.sampled_from(files))
    file = folder / "given.yaml"
    if data.draw(st.booleans()):
        file.write_text(text_of(mutate(plain(source), data)), encoding="utf-8",
                        errors="surrogatepass")
    else:
        file.write_bytes(damage(source.read_text(encoding="utf-8"), data))
    return file


@pytest.fixture(autouse=True)
def signals_as_they_were() -> Iterator[None]:
    """A node takes the signals for good: its process ends with it."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bad_input")
    for file in EXPERIMENTS[0].parent.glob("*.csv"):
        (path / file.name).write_bytes(file.read_bytes())
    return path


@settings(max_examples=60)
@given(data=st.data())
def test_model_yaml(folder: Path, data: st.DataObject) -> None:
    file = draw_yaml(MODELS, data, folder)
    try:
        load_model(file)
    except DfmError as error:
        one_line(error, "given.yaml")


@settings(max_examples=60)
@given(data=st.data())
def test_experiment_yaml(folder: Path, data: st.DataObject) -> None:
    file = draw_yaml(EXPERIMENTS, data, folder)
    try:
        experiment = load_experiment(file)
    except DfmError as error:
        one_line(error, "given.yaml")
        return
    if experiment.duration_s > 60.0:
        return
    for axis in experiment.axes:
        for make in (experiment.reference, experiment.excitation):
            try:
                make(axis, SHORTEST_S)
            except DfmError as error:
                one_line(error)


@settings(max_examples=40)
@given(data=st.data())
def test_parameter_yaml(folder: Path, data: st.DataObject) -> None:
    file = draw_yaml(PARAMETERS, data, folder)
    try:
        read_parameters(file, "x")
    except DfmError as error:
        one_line(error, "given.yaml")


cells = st.sampled_from(["0", "1", "0.001", "-1e3", "nan", "inf", "", " ", "x", "1,5", '"',
                         "1e400", "0x1", "#", "é", "\0", "1_0", "--1"])
rows = st.lists(st.lists(cells, max_size=5), max_size=12)
headers = st.sampled_from(["time_s,input_v,position_m", "t,u,x", "time,voltage,position", "",
                           "a;b", "time_s,time_s,position_m", "position_m",
                           "\ufefftime_s,input_v,position_m",
                           "time_s\tinput_v\tposition_m"])


@settings(max_examples=60)
@given(header=headers, some=rows, good=st.integers(0, 30), separator=st.sampled_from(",;\t "),
       tail=st.binary(max_size=5))
def test_csv(folder: Path, header: str, some: list[list[str]], good: int, separator: str,
             tail: bytes) -> None:
    lines = [header, *(f"{k * 0.001},{k % 3},{k * 1e-6}" for k in range(good)),
             *(separator.join(row) for row in some)]
    file = folder / "given.csv"
    file.write_bytes("\n".join(lines).encode() + tail)
    try:
        read_record(file)
    except DfmError as error:
        one_line(error, "given.csv")


@settings(max_examples=30)
@given(start=st.sampled_from([b"", b"\x89MCAP0\r\n", b"PK\x03\x04", b"MATLAB 5.0 MAT-file",
                              b"\x93NUMPY\x01\x00", b"\x1f\x8b"]),
       rest=st.binary(max_size=300), name=st.sampled_from(
           ["given.mcap", "given.npz", "given.mat", "given.csv", "given.txt", "given",
            "given.db3"]))
def test_any_bytes_as_a_record(folder: Path, start: bytes, rest: bytes, name: str) -> None:
    file = folder / name
    file.write_bytes(start + rest)
    try:
        read_record(file)
    except DfmError as error:
        one_line(error, "given")


def bad_files(folder: Path) -> dict[str, Path]:
    out = {name: folder / name for name in (
        "empty.yaml", "empty.csv", "binary.csv", "binary.yaml", "list.yaml", "folder",
        "nowhere.csv", "nowhere.yaml", "short.csv", "binary.mcap", "nowhere")}
    for name, path in out.items():
        if name == "folder":
            path.mkdir(exist_ok=True)
        elif not name.startswith("nowhere"):
            path.write_bytes({"e": b"", "b": bytes(range(256)) * 4, "l": b"[1, 2]\n",
                              "s": b"time_s,input_v,position_m\n0,0,0\n"}[name[0]])
    return out


TAKES_FILES = {"identify": [[]], "tune": [[]], "diagnose": [[], ["--model", "paper_stage"]],
               "characterize": [["--model"]], "learn": [["--experiment"], ["--model"], []],
               "demo": [["--model"]], "paper": [["--model"]]}


@pytest.mark.parametrize("tool", sorted(TAKES_FILES))
def test_command_lines(tool: str, tmp_path: Path, capfd: pytest.CaptureFixture[str],
                       monkeypatch: pytest.MonkeyPatch) -> None:
    files = bad_files(tmp_path)
    there = {path.name for path in tmp_path.iterdir()}
    monkeypatch.chdir(tmp_path)
    lines = [[*options, str(path)] for options in TAKES_FILES[tool] for path in files.values()]
    lines += [["--no-such-option"], ["--seed", "x"], ["--duration", "-1"], ["--output"],
              ["", ""]]
    for arguments in lines:
        try:
            code = main([tool, *arguments])
        except SystemExit as error:
            code = error.code
        said = capfd.readouterr().err
        assert code == 2, (arguments, code, said)
        assert "Traceback" not in said, arguments
        last = said.strip().splitlines()
        assert last, arguments
        assert {path.name for path in tmp_path.iterdir()} == there, arguments


@pytest.mark.parametrize(("arguments", "words"), [
    (["-p", "kp:=2.0"], "unknown arguments -p kp:=2.0: write parameters as --ros-args -p"),
    (["--ros-args", "-p", "kp:=x"], "parameter kp must be a real number"),
    (["--ros-args", "-p", "kp:=.nan"], "parameter kp = nan"),
    (["--ros-args", "-p"], "Couldn't parse trailing -p flag"),
    (["--ros-args", "--params-file", "nowhere.yaml"], "nowhere.yaml'. Error: Error opening"),
    (["--ros-args", "-p", "mode:=lqr", "-p", "model:=nowhere.yaml"], "nowhere.yaml: cannot be"),
])
def test_node_command_lines(arguments: list[str], words: str,
                            capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["controller", *arguments]) == 2
    last = capfd.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("error: ")
    assert words in last


def test_a_signal_of_days_is_refused_instead_of_filling_the_memory() -> None:
    experiment = load_experiment({"name": "a", "mode": "pid", "duration_s": 9e5,
                                  "axes": {"x": {"reference": {"kind": "hold"}}}})
    with pytest.raises(DfmError, match="has more than 20000000 samples"):
        experiment.reference("x", 1e-3)
