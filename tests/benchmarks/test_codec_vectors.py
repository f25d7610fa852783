"""The test vectors of docs/codec.md against the codec: a format that changes must change its document."""

from __future__ import annotations

import pytest

from benchmarks.codec import vectors
from onboard.codec import decode
from onboard.codec.container import unpack
from onboard.codec.quadtree.lattice import LAYOUTS
from onboard.codec.quadtree.symbols import CUTS, KINDS, SIZES, WEIGHT_SETS

DOCUMENTED = vectors.documented(vectors.DOCUMENT.read_text())
COUNT = 9


def test_every_codec_has_a_vector() -> None:
    plain, masked = ["quadtree"] * 3 + ["exact"] * 2, ["quadtree"] * 2 + ["exact"] * 2
    assert [fact["codec"] for fact, _ in DOCUMENTED] == plain + masked
    assert [unpack(frame).codec for _, frame in DOCUMENTED] == [1, 1, 1, 2, 3, 1, 1, 5, 6]
    assert [unpack(frame).payload[0] & 32 for _, frame in DOCUMENTED[5:7]] == [32, 32]


@pytest.mark.parametrize("number", range(COUNT))
def test_the_document_s_bytes_decode_to_what_it_says(number: int) -> None:
    fact, frame = DOCUMENTED[number]
    held = vectors.references([dump for _, dump in DOCUMENTED])
    assert vectors.facts(decode(frame, held)) == fact


def test_the_encoder_gives_the_document_s_bytes() -> None:
    assert vectors.vectors() == [frame for _, frame in DOCUMENTED]


def test_the_document_is_what_the_script_writes() -> None:
    text = vectors.DOCUMENT.read_text()
    assert text.partition(vectors.BEGIN)[2].partition(vectors.END)[0] == "\n" + vectors.markdown()


def test_the_document_knows_the_lattices() -> None:
    text = vectors.DOCUMENT.read_text()
    for name, layout in LAYOUTS.items():
        cuts = ", ".join(f"{down}x{across}" for down, across in layout.cuts)
        assert f"| {name} | {layout.rows} x {layout.columns} | {cuts} |" in text
    assert f"kind [{KINDS}]" in text
    assert f"{3 * KINDS} + depth for cuts" in text
    assert f"depth [{CUTS}]" in text
    assert f"i16\n({WEIGHT_SETS}, {len(SIZES) + 1})" in text


def test_writing_replaces_the_section_only(tmp_path, monkeypatch) -> None:
    path = tmp_path / "codec.md"
    path.write_text(f"before\n{vectors.BEGIN}old\n{vectors.END}after\n")
    monkeypatch.setattr(vectors, "DOCUMENT", path)
    assert vectors.main(["--write"]) == 0
    text = path.read_text()
    assert text.startswith("before\n")
    assert text.endswith(f"{vectors.END}after\n")
    assert "old" not in text
    assert len(vectors.documented(text)) == COUNT
