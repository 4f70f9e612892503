"""Everything that is compiled, compiled and kept on disk: `python -m dfm_stage.compile_all`.

Half a minute the first time on a machine, a second from then on. Set-up calls it, and whoever is
about to start processes that must not stop to compile.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np

from dfm_stage.arrays import Array


def compile_all() -> None:
    """Compile the simulator (plant, records, parameter sets, sensitivities), the hooks of all
    effects and the bag reader.
    """
    _simulator()
    _reader()


def _simulator() -> None:
    from dfm_stage.model import EFFECTS, CoupledPlant, Model, Simulator

    model = Model("compiled", 1e-3, base={"mass": 1.0, "damping": 1.0, "stiffness": 100.0})
    plant = CoupledPlant(model)
    plant.sample()
    plant.advance([0.0])
    Simulator(model).sensitivities(np.zeros(8), ("mass",))
    bare = Model("compiled", 1e-3, base={"mass": 1.0, "damping": 1.0, "coil_resistance": 1.0})
    for effect in EFFECTS.values():
        Simulator(bare.with_effect(effect.name, effect.defaults))
    _along()


def _along() -> None:
    from dfm_stage.model import EFFECTS
    from dfm_stage.model.formula import formula_of
    from dfm_stage.model.kernel import along, hooks

    def first(kind: str) -> tuple[int, Array]:
        effect = next(e for e in EFFECTS.values() if getattr(e, kind) is not None)
        return hooks.address(kind, [(effect, 0)]), np.array([*effect.defaults.values()])

    rest = np.zeros(8)
    along.forces_along(*first("force"), rest, rest, rest, np.zeros(8))
    along.bristles_along(*first("advance"), rest, rest, np.zeros(8))
    along.senses_along(*first("sense"), rest, 1e-3, np.empty(0), np.zeros(8))
    timed = {"name": "compiled", "parameters": {"k": {"value": 1.0}}}
    flow = formula_of({**timed, "force": "k * x * t"}).effect()
    along.flows_along(hooks.address("flow", [(flow, 0)]), np.ones(1), 0, rest, rest, rest, rest,
                      1.0, 1e-3, 0.0, np.zeros(8))
    added = formula_of({**timed, "input": "k * u * t"}).effect()
    along.additions_along(hooks.address("added", [(added, 0)]), np.ones(1), 1e-3, np.zeros(8))


def _reader() -> None:
    from dfm_stage.recording import BagWriter, read_bag

    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "whole"
        writer = BagWriter(whole)
        topic = writer.add_topic("/t", "std_msgs/msg/Float64", (), "", "float64 data\n")
        for k in range(4):
            writer.write(topic, bytes(12), k, k)
        writer.close()
        read_bag(whole)
        cut = Path(folder) / "cut.mcap"
        shutil.copy(writer.file_path, cut)
        with cut.open("r+b") as file:
            file.truncate(cut.stat().st_size - 200)
        read_bag(cut)


if __name__ == "__main__":
    compile_all()
