"""Drawings of the benches as PNG files that appear whole or not at all."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from dfm_stage.files import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOCS = Path(__file__).resolve().parents[1] / "docs/pictures"


def write_picture(figure: Figure, target: Path, dpi: int = 80) -> None:
    """Write a drawing to `target`, a .png file; raises OSError if it cannot be written."""
    png = BytesIO()
    figure.savefig(png, format="png", dpi=dpi)
    write_whole(target, png.getvalue())
