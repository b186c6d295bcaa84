"""A file is on the disk before it takes the place of the old one."""

import os

from compare.files import replace_file


def test_the_content_is_on_the_disk_before_the_old_file_is_replaced(tmp_path, monkeypatch):
    order = []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda descriptor: (order.append("fsync"), fsync(descriptor)))
    monkeypatch.setattr(os, "replace", lambda side, path: (order.append(side.read_bytes()), replace(side, path)))
    path = tmp_path / "page.html"
    path.write_bytes(b"old")
    replace_file(path, b"new")
    assert order == ["fsync", b"new"]
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]
