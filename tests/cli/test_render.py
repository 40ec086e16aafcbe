"""What commands print for people."""

from __future__ import annotations

import io
import sys

from tracker.cli.render import bar


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_bar_leaves_its_line_once_all_is_done(monkeypatch):
    shown = Terminal()
    monkeypatch.setattr(sys, "stderr", shown)
    with bar("frames", 3, quiet=False) as advance:
        for _ in range(3):
            assert "frames" in shown.getvalue()
            advance(1)
        done = shown.getvalue()
        assert done.endswith("\r")
        assert not done.rsplit("\r", 2)[1].strip()
        advance(1)
    assert shown.getvalue() == done
