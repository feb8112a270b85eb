"""FMUs made to do harm: each is refused with an error message, at once, and nothing is written."""

import io
import re
import struct
import time
import zipfile
import zlib

import pytest

from experiments import single
from fmu_files import PROBE_VARIABLES, description_xml, paper_fmu

SECONDS = 1.0  # to refuse an FMU; a busy machine gets a few times as many
XML = description_xml("trap", PROBE_VARIABLES)


@pytest.fixture
def refused(problems, tmp_path):
    """refused(path) -> the error message for the FMU; fails if it takes long or leaves anything behind."""

    def find(path):
        before = {*tmp_path.rglob("*"), tmp_path / "mine.toml"}
        began = time.perf_counter()
        ((key, sentence),) = problems(single(path))
        took = time.perf_counter() - began
        assert key == "components.one.fmu"
        assert str(path) in sentence
        assert took < 5 * SECONDS, took
        assert set(tmp_path.rglob("*")) <= before
        return sentence

    return find


@pytest.fixture
def trap(tmp_path):
    """The path of an FMU that is well, for a test to spoil."""
    return paper_fmu(tmp_path / "trap.fmu")


def with_description(path, xml):
    """The FMU with another modelDescription.xml, text or bytes."""
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in {**files, "modelDescription.xml": xml}.items():
            archive.writestr(name, content)
    return path


def with_doctype(declarations, use=""):
    """The description with a document type, and `use` in place of its own."""
    return f"<?xml version='1.0'?>\n<!DOCTYPE fmiModelDescription [{declarations}]>\n" + XML.partition("?>")[2].replace(
        'description="A probe"', f'description="{use}"'
    )


LAUGHS = '<!ENTITY a0 "ha">' + "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12))


@pytest.mark.parametrize(
    "xml",
    [
        with_doctype(LAUGHS, "&a11;"),
        with_doctype(LAUGHS, "&a11;").replace("</fmiModelDescription>", "&a11;</fmiModelDescription>"),
        with_doctype(f'<!ENTITY big "{"x" * 100_000}">', "&big;" * 1000),
        with_doctype('<!ENTITY secret SYSTEM "file:///etc/passwd">').replace("</fmiM", "&secret;</fmiM"),
        with_doctype('<!ENTITY % there SYSTEM "http://127.0.0.1:9/evil.dtd"> %there;'),
        with_doctype(""),
        XML.replace("?>", '?>\n<!DOCTYPE fmiModelDescription SYSTEM "http://127.0.0.1:9/evil.dtd">', 1),
        with_doctype(LAUGHS, "&a11;").encode("utf-16"),
        # An encoding that expat does not know and libxml2 does.
        with_doctype(LAUGHS, "&a1;").replace("version='1.0'", "version='1.0' encoding='cp932'").encode("cp932"),
    ],
    ids=["attribute", "text", "quadratic", "file", "parameter", "empty", "external", "utf-16", "cp932"],
)
def test_a_description_with_a_document_type_is_not_read(refused, trap, xml):
    assert "has a document type" in refused(with_description(trap, xml))


@pytest.mark.parametrize(
    "xml",
    [
        "<a>" * 100_000,
        "<a>" * 100_000 + "</a>" * 100_000,
        XML.replace("A probe", "x" * 20_000_000),
        XML.replace("<ModelVariables>", f"<ModelVariables>{'y' * 20_000_000}"),
        XML.encode("utf-16")[:-1],
        XML.replace("A probe", "déjà vu").encode("latin-1"),
        XML.replace("utf-8", "klingon").replace("UTF-8", "klingon"),
        XML.replace("A probe", "a\0b"),
        XML.replace("A probe", "&#0;"),
        XML.replace("A probe", "&#xD800;"),
        XML.replace("A probe", "&nbsp;"),
        "",
        b"\xff\xfe\x00",
        b"PK\x05\x06",
    ],
    ids=[
        "open",
        "deep",
        "attribute",
        "text",
        "utf-16",
        "latin-1",
        "klingon",
        "nul",
        "zero",
        "surrogate",
        "entity",
        "empty",
        "bytes",
        "zip",
    ],
)
def test_a_description_that_cannot_be_read_is_reported_at_once(refused, trap, xml):
    assert "modelDescription.xml cannot be read: " in refused(with_description(trap, xml))


def test_a_description_of_absurd_length_is_not_parsed(refused, trap):
    assert "modelDescription.xml is over 64 MB" in refused(with_description(trap, b" " * (65 << 20)))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "iso-8859-1", "cp1252"])
def test_a_description_may_have_any_encoding_that_it_names(orch, trap, write, encoding):
    xml = re.sub(r"<\?xml.*?\?>", f'<?xml version="1.0" encoding="{encoding.removesuffix("-sig")}"?>', XML)
    with_description(trap, xml.replace("A probe", "déjà vu").encode(encoding))
    answer = orch("fmus", trap, "--json")
    assert answer.code == 0, answer.err
    assert answer.json["description"] == "déjà vu"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("resources/a\x01b", "control character"),
        ("resources/nul", "means another file on Windows"),
        ("resources/COM1.txt", "means another file on Windows"),
        ("aux/a", "means another file on Windows"),
        ("resources/a. /b", "means another file on Windows"),
        ("resources/a.", "means another file on Windows"),
        ("MODELDESCRIPTION.XML", "same file on some systems"),
        ("Binaries/a", "same file on some systems"),
        ("modelDescription.xml/a", "as a file and as a folder"),
        ("modelDescription.xml", "twice"),
        ("resources/", ""),
        ("resources/console.txt", ""),
        ("resources/.hidden", ""),
    ],
)
def test_names_that_mean_two_things_are_refused(refused, orch, trap, name, words):
    with zipfile.ZipFile(trap, "a") as archive, pytest.MonkeyPatch.context() as quiet:
        quiet.setattr("warnings.warn", lambda *_, **__: None)  # zipfile's, of a name that occurs twice
        archive.writestr(name, "" if name.endswith("/") else "got you")
    if words:
        assert words in refused(trap)
    else:
        assert orch("fmus", trap).code == 0


def test_a_name_that_hides_behind_a_nul_is_refused(refused, trap):
    with zipfile.ZipFile(trap, "a") as archive:
        archive.writestr("resources/evil.so?.txt", "got you")
    trap.write_bytes(trap.read_bytes().replace(b"evil.so?.txt", b"evil.so\0.txt"))
    assert "control character in its name: 'resources/evil.so\\x00.txt'" in refused(trap)


def fifield(files, kernel):
    """A zip whose files all share the bytes of one: the full overlap of Fifield's bomb."""
    squeezer = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = squeezer.compress(bytes(kernel)) + squeezer.flush()
    crc = zlib.crc32(bytes(kernel))
    local = struct.pack("<4s5H3L2H", b"PK\3\4", 20, 0, 8, 0, 0, crc, len(packed), kernel, 1, 0) + b"a" + packed
    directory = b"".join(
        struct.pack("<4s6H3L5H2L", b"PK\1\2", 20, 20, 0, 8, 0, 0, crc, len(packed), kernel, len(name), 0, 0, 0, 0, 0, 0)
        + name
        for name in (b"%06d" % i for i in range(files))
    )
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, files % 65536, files % 65536, len(directory), len(local), 0)
    return local + directory + end


@pytest.mark.parametrize(
    ("files", "kernel", "words"),
    [
        (250, 100_000, "overlap"),
        (5_000, 100_000, "absurd size"),
        (30_000, 10, "over 20000 files"),
        (1_000_000, 10, "over 20000 files"),
    ],
)
def test_files_that_share_their_bytes_are_refused(refused, trap, files, kernel, words):
    trap.write_bytes(fifield(files, kernel))
    assert words in refused(trap)


def test_many_files_of_a_bearable_ratio_each_are_absurd_together(refused, trap):
    with zipfile.ZipFile(trap, "a", zipfile.ZIP_DEFLATED) as archive:
        for i in range(30):
            archive.writestr(f"resources/{i}", bytes(10 << 20))
    assert "absurd size" in refused(trap)


@pytest.mark.parametrize(
    ("method", "words"),
    [
        (zipfile.ZIP_BZIP2, "FMI does not allow"),
        (zipfile.ZIP_LZMA, "FMI does not allow"),
    ],
)
def test_only_the_compression_of_fmi_is_opened(refused, trap, method, words):
    with zipfile.ZipFile(trap, "a", method) as archive:
        archive.writestr("resources/a", bytes(1000))
    assert words in refused(trap)


def test_an_encrypted_file_is_reported_as_such(refused, trap):
    content = bytearray(trap.read_bytes())
    content[content.index(b"PK\1\2") + 8] |= 1
    trap.write_bytes(content)
    assert "has an encrypted file" in refused(trap)


def test_a_size_that_lies_unpacks_no_more_than_it_says(refused, trap):
    """The description says that it has 100 bytes, and would unpack to a hundred million."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", bytes(100_000_000))
    trap.write_bytes(file.getvalue().replace(struct.pack("<L", 100_000_000), struct.pack("<L", 100)))
    assert "is damaged" in refused(trap)


def test_an_fmu_that_changes_after_it_was_checked_does_not_run(python, trap, write):
    table = single("trap.fmu")
    write(table)
    answer = python("""
import orchestrator as orch
from pathlib import Path
from orchestrator.runs import runner
from orchestrator.runs.prepare import prepare
plan = prepare("mine.toml")
Path("trap.fmu").write_bytes(Path("trap.fmu").read_bytes() + b" ")
try:
    runner.execute(plan)
except orch.OrchError as error:
    print(error)
""")
    assert "trap.fmu has changed since it was checked" in answer.out, answer.err
