"""Pages whose nodes run against the clock: a file apart, so that the other pages run beside
other tests."""

from __future__ import annotations

from pathlib import Path

import pytest
from pages import PAGES, marks
from running import run_page


@pytest.mark.real_time
@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if "real_time" in marks(page)],
                         ids=lambda page: page.name)
def test_the_page_runs_in_real_time(page: Path, tmp_path: Path,
                                    monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run_page(page, tmp_path)
