"""The picture of the screen: over the links, and the PNG against Pillow as an independent reader."""

import io
import struct

import numpy as np
import pytest
from PIL import Image

from instrument import TransferError
from instrument.simulated import Fault
from instrument.tds2014.knobs import png_from_bmp


def test_screen_over_the_link(bench, tmp_path):
    bench.acquire(1)
    picture = bench.screen()
    path = tmp_path / "screen.png"
    picture.save(path)
    assert picture._repr_png_() == path.read_bytes()
    with Image.open(path) as image:
        assert image.format == "PNG"
        assert image.size == (320, 240)
        colours = image.convert("RGB").getcolors()
    assert len(colours) >= 4  # background, graticule, frame, traces
    # In step afterwards, and the printer settings are put back at the end.
    assert bench.acquire(1).codes.shape == (2500,)
    assert bench.query("HARDCOPY:FORMAT?") == "BMP"
    bench.restore()
    assert bench.query("HARDCOPY:FORMAT?;PORT?") == "EPSON;CENTRONICS"


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", [*(pytest.param(kind, marks=pytest.mark.slow) for kind in ("cut answer", "lost answer")), "garbage"]
)
def test_damaged_picture_is_refused(bench, bench_scope, kind, monkeypatch):
    monkeypatch.setattr("instrument.tds2014.knobs._PICTURE_TIME", 0.5)
    bench.screen()
    bench_scope.faults.add(Fault(kind, shortest=10_000, bytes_sent=2000))
    with pytest.raises(TransferError):
        bench.screen()
    bench_scope.faults.clear()
    assert bench.screen().png.startswith(b"\x89PNG")


@pytest.mark.parametrize("mode", ["1", "P", "RGB"])
def test_png_has_the_pixels_of_the_bmp(mode):
    pixels = np.random.default_rng(7).integers(0, 256, (13, 21, 3), dtype=np.uint8)
    image = Image.fromarray(pixels)
    image = image.quantize(50) if mode == "P" else image.convert(mode)
    bmp = io.BytesIO()
    image.save(bmp, format="BMP")
    with Image.open(io.BytesIO(png_from_bmp(bmp.getvalue()))) as png:
        np.testing.assert_array_equal(np.asarray(png.convert("RGB")), np.asarray(image.convert("RGB")))


def test_not_a_plain_bitmap():
    with pytest.raises(TransferError, match="too short"):
        png_from_bmp(b"BM")
    header = struct.pack("<2sIHHIIiiHHI", b"BM", 60, 0, 0, 54, 40, 4, 4, 1, 8, 1)
    with pytest.raises(TransferError, match="compression 1"):
        png_from_bmp(header + bytes(60))
    header = struct.pack("<2sIHHIIiiHHI", b"BM", 60, 0, 0, 54, 40, 400, 400, 1, 24, 0)
    with pytest.raises(TransferError, match="cut"):
        png_from_bmp(header + bytes(60))
