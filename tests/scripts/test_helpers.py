"""Commands that write refuse to write over what they read."""

from pathlib import Path

import pytest

from scripts.helpers import check_outputs


def test_an_input_is_no_output(tmp_path: Path) -> None:
    check_outputs((tmp_path / "a", None), (tmp_path / "b", None))
    (tmp_path / "link").symlink_to(tmp_path / "b")
    for output in (tmp_path / "b", tmp_path / "x" / ".." / "b", tmp_path / "link"):
        with pytest.raises(ValueError, match="expected another place"):
            check_outputs((None, output), (tmp_path / "b",))
