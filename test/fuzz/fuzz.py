"""Coverage-guided fuzzing of what reads from outside; not part of the test suite.

    pip install atheris                        # CPython 3.11 to 3.13, Linux
    PYTHONPATH=. python test/fuzz/fuzz.py copley -max_total_time=300
    PYTHONPATH=. python test/fuzz/fuzz.py corpus=FOLDER mat -rss_limit_mb=4096

The targets are those of `./run bench bytes`, each begun with its seeds; atheris then keeps what
reaches new branches of the package. It stops at the first input that ends wrongly and writes it.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from pathlib import Path
from random import Random

import atheris

with atheris.instrument_imports(include=["dfm_stage"]):
    from benchmarks.bytes_targets import SEEDS, TARGETS, input_of
    from benchmarks.bytes_worker import ending_of

SEED_INPUTS = 50


def main() -> None:
    """Fuzz the target named on the command line."""
    arguments = sys.argv[1:]
    folder = Path(tempfile.mkdtemp(prefix="dfm_fuzz_"))
    corpus = folder / "corpus"
    if arguments and arguments[0].startswith("corpus="):
        corpus = Path(arguments.pop(0).removeprefix("corpus="))
    if not arguments or arguments[0] not in TARGETS:
        sys.exit(f"usage: fuzz.py [corpus=FOLDER] {'|'.join(TARGETS)} [libFuzzer options]")
    target = TARGETS[arguments[0]]
    corpus.mkdir(parents=True, exist_ok=True)
    ending = Path(target.file).suffix or ".bin"
    seeds = [path.read_bytes() for path in SEEDS.glob(f"*{ending}")
             if ending != ".bin" or path.stem == target.name]
    seeds += [input_of(target, 0, number) for number in range(SEED_INPUTS)]
    for number, data in enumerate(seeds):
        (corpus / f"seed_{number}").write_bytes(data)
    path = folder / target.file
    warnings.simplefilter("ignore")

    def once(data: bytes) -> None:
        _, wrong, details = ending_of(target, data, path)
        if wrong:
            raise RuntimeError(f"{wrong}\n{details}")

    def mutate(data: bytes, size: int, seed: int) -> bytes:
        """Half of the steps are the target's own, which know the format."""
        if seed % 2:
            return atheris.Mutate(data, size)
        return target.make(Random(seed))[:size]

    atheris.Setup([sys.argv[0], str(corpus), *arguments[1:]], once, custom_mutator=mutate)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
