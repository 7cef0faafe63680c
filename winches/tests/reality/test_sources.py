"""How files of logs are found, downloaded and refused."""

import io
from urllib.error import URLError

import pytest
from reality.synthetic import source_of, written

from cablebot_winches.reality import STUDIES
from cablebot_winches.reality.sources import SOURCES, read_logs

FILES = {"tests/1kg/Up.csv": b"light", "tests/5kg/Up.csv": b"heavy"}


def no_network(url, timeout):
    raise URLError("no route")


def test_every_study_has_a_source_with_full_hashes():
    assert SOURCES.keys() == STUDIES.keys()
    for source in SOURCES.values():
        assert len(source.commit) == 40
        assert {len(digest) for digest in source.files.values()} == {64}


@pytest.mark.parametrize(
    "names",
    [
        ("tests/1kg/Up.csv", "tests/5kg/Up.csv"),
        ("a/1kg_Up.csv", "a/5kg_Up.csv"),
        ("Up.csv", "b/Up.csv"),
    ],
)
def test_files_are_found_by_content_in_any_layout(tmp_path, names):
    """Files of two folders have the same name: the first one must not serve for both."""
    logs = written(dict(zip(names, FILES.values(), strict=True)), tmp_path / "logs")
    assert read_logs(source_of(FILES), logs, no_network) == FILES


def test_other_version_of_a_file_is_refused_with_its_address(tmp_path):
    logs = written({**FILES, "tests/5kg/Up.csv": b"heavier"}, tmp_path / "logs")
    with pytest.raises(ValueError, match=r"no file Up\.csv in .* has the SHA-256") as raised:
        read_logs(source_of(FILES), logs, no_network)
    address = f"https://raw.githubusercontent.com/owner/name/{'c' * 40}/tests/5kg/Up.csv"
    assert f"Download {address}, or leave --logs out" in str(raised.value)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"has no file Up\.csv\. Download https://"):
        read_logs(source_of(FILES), tmp_path, no_network)


def test_download_is_kept_in_the_cache(cache):
    opened = []

    def serve(url, timeout):
        opened.append(url)
        return io.BytesIO(FILES[url.partition("c" * 40 + "/")[2]])

    source = source_of(FILES)
    assert read_logs(source, None, serve) == FILES
    assert len(opened) == 2
    assert read_logs(source, None, no_network) == FILES


def test_wrong_download_is_refused_and_not_kept(cache):
    with pytest.raises(ValueError, match="does not have the expected SHA-256"):
        read_logs(source_of(FILES), None, lambda url, timeout: io.BytesIO(b"not found"))
    assert not cache.exists()


def test_without_a_network_the_message_names_address_and_option(cache):
    with pytest.raises(ConnectionError, match="no route") as raised:
        read_logs(source_of(FILES), None, no_network)
    for text in ("cannot download https://raw.githubusercontent.com/owner/name/", "--logs"):
        assert text in str(raised.value)
