import hashlib
import json
import os
from pathlib import Path

import pytest

from beso.errors import UserError
from beso.files import from_home, read_json, replacing, sha256, write_json, write_text


def contents(folder):
    return {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*") if p.is_file()}


def test_a_file_appears_whole_and_replaces_the_old_one(tmp_path):
    path = tmp_path / "new" / "file.txt"
    for text in ("first", "second"):
        with replacing(path) as temporary:
            temporary.write_text(text)
            assert temporary.parent == path.parent, "a rename works within one file system only"
            assert not path.exists() or path.read_text() == "first"
        assert contents(tmp_path) == {"new/file.txt": text}


def test_a_folder_replaces_the_old_one_as_a_whole(tmp_path):
    path = tmp_path / "folder"
    for name in ("a", "b"):
        with replacing(path) as temporary:
            temporary.mkdir()
            (temporary / name).write_text(name)
    assert contents(tmp_path) == {"folder/b": "b"}
    assert [p.name for p in tmp_path.iterdir()] == ["folder"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_failure_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "file.txt"
    path.write_text("old")

    def fail():
        with replacing(path) as temporary:
            temporary.write_text("half of the n")
            raise error

    with pytest.raises(error):
        fail()
    assert contents(tmp_path) == {"file.txt": "old"}


def test_failure_leaves_the_old_folder_and_nothing_else(tmp_path):
    path = tmp_path / "folder"
    path.mkdir()
    (path / "a").write_text("old")

    def fail():
        with replacing(path) as temporary:
            temporary.mkdir()
            (temporary / "a").write_text("new")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert contents(tmp_path) == {"folder/a": "old"}
    assert [p.name for p in tmp_path.iterdir()] == ["folder"]


def test_a_body_that_wrote_nothing_leaves_the_old_folder(tmp_path):
    path = tmp_path / "folder"
    path.mkdir()
    (path / "a").write_text("old")
    with pytest.raises(FileNotFoundError), replacing(path):
        pass
    assert contents(tmp_path) == {"folder/a": "old"}


def test_json_is_sorted_and_ends_in_a_newline(tmp_path):
    write_json(tmp_path / "x.json", {"b": 1, "a": [1, 2]})
    text = (tmp_path / "x.json").read_text()
    assert json.loads(text) == {"a": [1, 2], "b": 1}
    assert text.index('"a"') < text.index('"b"')
    assert text.endswith("}\n")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: None, "is missing"),
        (lambda path: path.mkdir(), "is not a file"),
        (os.mkfifo, "is not a file"),
        (lambda path: path.write_text("[" * 10**5), "is damaged: maximum recursion"),
        (lambda path: path.write_bytes(b"\xff"), "is damaged: 'utf-8' codec"),
        (lambda path: path.write_text("[]"), "is damaged: it holds no mapping"),
    ],
)
def test_what_is_no_json_mapping_is_one_line(tmp_path, make, message):
    make(tmp_path / "x.json")
    with pytest.raises(UserError, match=f"x.json {message}"):
        read_json(tmp_path / "x.json")


def test_text_is_utf_8(tmp_path):
    write_text(tmp_path / "x.txt", "ä → 0\n")
    assert (tmp_path / "x.txt").read_bytes() == "ä → 0\n".encode()


def test_sha256_is_that_of_the_bytes(tmp_path):
    data = bytes(range(256)) * 5000  # more than one block
    (tmp_path / "x").write_bytes(data)
    assert sha256(tmp_path / "x") == hashlib.sha256(data).hexdigest()


def test_a_home_that_is_not_there_is_one_line():
    assert from_home("~/x") == Path.home() / "x"
    with pytest.raises(UserError, match=r"^~nobody-of-this-name/x: there is no such user's home$"):
        from_home("~nobody-of-this-name/x")
