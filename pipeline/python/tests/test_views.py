"""Views of a run."""

from __future__ import annotations

import json
import urllib.error
import urllib.request

import magline
import pytest
from magline.views import View


def get(address: str) -> bytes:
    with urllib.request.urlopen(address, timeout=60) as answer:
        found: bytes = answer.read()
    return found


def test_a_view_serves_the_tables_of_the_run(run: magline.Run) -> None:
    with run.view(browser=False) as view:
        catalogue = json.loads(get(view.address + "api/catalogue"))
        names = {table["name"] for pipeline in catalogue["pipelines"] for table in pipeline["tables"]}
        assert set(run.tables) <= names
        assert b"<main>" in get(view.address)
        assert f'src="{view.address}"' in view._repr_html_()
        with pytest.raises(urllib.error.HTTPError, match="404"):
            get(view.address[:-2] + "/")
    with pytest.raises(urllib.error.URLError):
        get(view.address)


def test_a_folder_without_a_store_is_reported(tmp_path: object) -> None:
    with pytest.raises(RuntimeError, match="is not a store"):
        View(str(tmp_path))
