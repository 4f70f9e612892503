"""Reports: one self-contained HTML page, its plots and tables, numbers as people read them."""

from dfm_stage.quantity import Quantity, display_unit, format_number, format_quantity
from dfm_stage.reporting.figures import (
    Drawing,
    Response,
    bode_figure,
    log_labels,
    new_figure,
    page_style,
    statistics,
    thinned,
    time_figure,
)
from dfm_stage.reporting.page import Page, ReportError
from dfm_stage.reporting.table import Link, Table

__all__ = [
    "Drawing", "Link", "Page", "Quantity", "ReportError", "Response", "Table", "bode_figure",
    "display_unit", "format_number", "format_quantity", "log_labels", "new_figure", "page_style",
    "statistics", "thinned", "time_figure",
]
