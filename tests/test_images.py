"""The one reader of images: levels by the file's type or a key, one luma, orientation once, limits before decoding."""

import io
import struct
import sys
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from harness import images
from harness.camera.intrinsics import Camera
from harness.camera.sensor import Sensor
from harness.cli import main
from harness.errors import InputError
from harness.images import decode
from harness.pipeline.photographs import read_photograph
from harness.simulation.texture import ImageTexture, texels_of
from harness.spec import dump_toml

EIGHT = np.random.default_rng(1).integers(0, 256, (8, 8)).astype(np.uint8)
RGB = np.stack([EIGHT, 255 - EIGHT, EIGHT // 2], axis=-1)


def encoded(pixels, form="PNG", **options):
    stream = io.BytesIO()
    image = pixels if isinstance(pixels, Image.Image) else Image.fromarray(pixels)
    image.save(stream, form, **options)
    return stream.getvalue()


def refusal(data, **options):
    with pytest.raises(InputError) as caught:
        decode(data, "wall.tif", **options)
    assert str(caught.value).startswith("wall.tif: ")
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("data", "white", "grey"),
    [
        (encoded(EIGHT), None, EIGHT),
        (encoded(EIGHT, "TIFF"), None, EIGHT),
        # 16 bits whose levels fit into 8: a dark image, and dark it stays.
        (encoded(EIGHT.astype(np.uint16)), None, EIGHT / 257),
        (encoded(EIGHT.astype(np.uint16)), 255, EIGHT),
        (encoded(4 * EIGHT.astype(np.uint16)), 1023, EIGHT * (4 * 255 / 1023)),
        (encoded(16 * EIGHT.astype(np.uint16), "TIFF"), 4095, EIGHT * (16 * 255 / 4095)),
        (encoded(257 * EIGHT.astype(np.uint16), "TIFF"), None, EIGHT),
        (encoded((EIGHT / 255).astype(np.float32), "TIFF"), None, EIGHT),
        (encoded(EIGHT.astype(np.float32), "TIFF"), 255, EIGHT),
        (encoded(EIGHT.astype(np.int32), "TIFF"), 255, EIGHT),
        (encoded(Image.fromarray(EIGHT > 100)), None, np.where(EIGHT > 100, 255, 0)),
        (b"P5\n8 8\n1000\n" + (3 * EIGHT.astype(int)).astype(">u2").tobytes(), None, EIGHT * (3 * 255 / 1000)),
    ],
)
def test_levels_go_by_the_type_and_the_key(data, white, grey):
    picture = decode(data, "wall.tif", white=white)
    # Single precision of 255; a PGM's levels are first rounded to 16 bits.
    np.testing.assert_allclose(picture.grey(), grey, rtol=0, atol=4e-3 if data.startswith(b"P5") else 2e-5)
    np.testing.assert_array_equal(picture.colour()[..., 0], np.rint(picture.grey()))
    assert ("as white says" in picture.scale) == (white is not None)


def test_colours_become_bt_601_luma_and_grey_stays_exact():
    weights = 0.299 * RGB[..., 0].astype(float) + 0.587 * RGB[..., 1] + 0.114 * RGB[..., 2]
    np.testing.assert_allclose(decode(encoded(RGB), "a").grey(), weights, rtol=0, atol=1e-4)  # single precision
    every = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=-1)
    np.testing.assert_array_equal(decode(encoded(every), "a").grey()[0], np.arange(256))


def test_textures_and_photographs_are_read_alike(tmp_path):
    (tmp_path / "a.png").write_bytes(encoded(RGB))
    sensor = Sensor(camera=Camera(width_px=8, height_px=8, focal_px=7.0, cx_px=3.5, cy_px=3.5))
    texels = texels_of(ImageTexture(kind="image", file=str(tmp_path / "a.png"), tile_m=1))
    photograph = read_photograph(tmp_path / "a.png", sensor)
    np.testing.assert_array_equal(texels, photograph.grey)
    np.testing.assert_array_equal(photograph.colour, RGB)


def test_a_factor_of_light_is_not_one_of_levels():
    picture = decode(encoded(np.full((1, 1), 188, np.uint8)), "a")
    assert picture.grey((0.5, 0.5, 0.5))[0, 0] == 94
    # sRGB: level 188 is 50.3 % of the light of white, 137 is 25.2 %.
    assert picture.grey((0.5, 0.5, 0.5), linear=True)[0, 0] == pytest.approx(137, abs=0.5)
    assert picture.grey((1.0, 1.0, 1.0), linear=True)[0, 0] == 188


@pytest.mark.parametrize("form", ["JPEG", "PNG", "TIFF", "WEBP"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_applied_once(form, orientation):
    # Four grey quarters, large enough for lossy formats.
    upright = np.kron(np.array([[20, 90], [160, 240]], np.uint8), np.ones((16, 24), np.uint8))
    stored = {
        1: upright, 2: upright[:, ::-1], 3: upright[::-1, ::-1], 4: upright[::-1],
        5: upright.T, 6: np.rot90(upright, 1), 7: upright[::-1, ::-1].T, 8: np.rot90(upright, -1),
    }[orientation]  # fmt: skip
    exif = Image.Exif()
    exif[0x0112] = orientation
    image = Image.fromarray(np.ascontiguousarray(stored))
    data = encoded(image.convert("RGB") if form == "WEBP" else image, form, exif=exif)
    picture = decode(data, "a", size=(48, 32))
    assert np.abs(picture.grey()[4:-4:8, 4:-4:8] - upright[4:-4:8, 4:-4:8]).max() < 8  # of lossy compression


@pytest.mark.parametrize(
    ("data", "said", "options"),
    [
        (encoded(np.where(EIGHT > 200, np.nan, EIGHT).astype(np.float32), "TIFF"), "not finite", {}),
        (encoded(np.where(EIGHT > 200, np.inf, 0).astype(np.float32), "TIFF"), "not finite", {}),
        (encoded(EIGHT.astype(np.float32) * np.float32(1e30), "TIFF"), "outside 0 .. 1; white says", {}),
        (encoded(EIGHT.astype(np.float32), "TIFF"), "white says which level is white", {}),
        (encoded(EIGHT.astype(np.float32) - 300, "TIFF"), "outside", {"white": 255}),
        (encoded(EIGHT.astype(np.int32), "TIFF"), "do not state what is white; give white", {}),
        (encoded(257 * EIGHT.astype(np.uint16)), "--bits says", {"white": 1023, "key": "--bits"}),
        (encoded(EIGHT, "PPM"), "leave --bits out", {"white": 1023, "key": "--bits"}),
        (encoded(EIGHT), "8 bits, so that no level reaches --bits", {"white": 1023, "key": "--bits"}),
        (encoded(EIGHT), "8x8 pixels, give another", {"size": (9, 8), "size_hint": "give another"}),
        (encoded(RGB)[:60], "cannot be read as an image", {}),
        (b"", "cannot be read as an image", {}),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "give a PNG, JPEG or TIFF", {}),
    ],
)
def test_refused_by_name(data, said, options):
    assert said in refusal(data, **options)


def bomb(width, height, depth=1, colour=0):
    """A PNG that says how large it is, in few bytes."""
    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", zlib.compress(bytes(1000))), (b"IEND", b""))
    chunks = [struct.pack(">I", len(d)) + t + d + struct.pack(">I", zlib.crc32(t + d)) for t, d in parts]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


@pytest.mark.parametrize("size", [(8193, 8192), (12000, 12000), (20000, 20000), (2**31 - 1, 2**31 - 1), (2**26, 2)])
def test_bombs_are_refused_from_their_header(size, monkeypatch):
    monkeypatch.setattr(Image.Image, "load", lambda _: pytest.fail("decoded"))
    # Pillow's own limit, which is higher, may be met first.
    assert "67 million" in refusal(bomb(*size))


def test_sixteen_bits_a_colour_are_not_cut_to_eight():
    assert "16 bits a colour" in refusal(bomb(8, 6, 16, 2))


def test_large_files_are_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr("harness.simulation.texture.LIMIT_BYTES", 10)
    (tmp_path / "a.png").write_bytes(encoded(EIGHT))
    with pytest.raises(InputError, match=r"a\.png: is larger than"):
        texels_of(ImageTexture(kind="image", file=str(tmp_path / "a.png"), tile_m=1))


@pytest.mark.parametrize(("brightest", "said"), [(8191, True), (8192, False)])
def test_a_dim_image_stays_dim_and_its_brightest_level_is_said(brightest, said):
    """16 bits, of which three hold nothing: no guess is made, and the key that helps is named."""
    levels = np.minimum(EIGHT.astype(np.uint16) * 257, brightest)
    levels.flat[0] = brightest
    picture = decode(encoded(levels), "l.png", key="--bits")
    assert picture.white == 65535
    assert (f"no level is above {brightest}: if white is less than 65535, give --bits" in picture.scale) == said


@pytest.mark.slow
def test_the_command_says_how_levels_were_read(tmp_path, capsys):
    sensor = Sensor(camera=Camera(width_px=80, height_px=60, focal_px=76.7, cx_px=39.5, cy_px=29.5))
    (tmp_path / "s.toml").write_text(dump_toml(sensor))
    levels = np.random.default_rng(1).integers(0, 1024, (2, 60, 80)).astype(np.uint16)
    levels[1] //= 8  # much darker: scaled by itself, it would be as bright as the other
    for name, each in zip(("l.png", "r.png"), levels, strict=True):
        Image.fromarray(each).save(tmp_path / name)
    command = [
        "range", "l.png", "r.png", "--sensor", "s.toml", "--baseline", "0.5", "0", "0", "--out", "out",
        "--matcher", "window", "--set", "panorama.width_px=90", "--set", "panorama.height_px=25",
    ]  # fmt: skip
    command = [str(tmp_path / each) if each.endswith(("png", "toml")) or each == "out" else each for each in command]
    assert main([*command, "--bits", "10"]) == 0
    assert capsys.readouterr().out.count("16 bits, white is 1023 (as --bits says)") == 2
    assert "white is 1023 (as --bits says)" in (tmp_path / "out" / "range.html").read_text()
    assert main([*command, "--bits", "9"]) == 2
    assert "l.png: has levels" in capsys.readouterr().err
    both = [read_photograph(tmp_path / name, sensor, 10).grey for name in ("l.png", "r.png")]
    np.testing.assert_allclose(both, levels * (255 / 1023), rtol=0, atol=2e-5)


@pytest.mark.skipif(sys.platform == "win32", reason="libtiff is part of Pillow's own library there")
@pytest.mark.parametrize("compression", ["tiff_lzw", "tiff_deflate", "jpeg"])
def test_libtiff_does_not_write_to_stderr(compression, capfd):
    data = encoded(np.tile(RGB, (8, 8, 1)), "TIFF", compression=compression)
    refusal(data[:8] + bytes(len(data[8:-400])) + data[-400:])
    assert capfd.readouterr() == ("", "")


SEEDS = [
    encoded(RGB), encoded(EIGHT), encoded(257 * EIGHT.astype(np.uint16)), encoded(RGB, "JPEG"), encoded(RGB, "TIFF"),
    encoded((EIGHT / 255).astype(np.float32), "TIFF"), encoded(RGB, "TIFF", compression="tiff_lzw"),
    encoded(RGB, "WEBP"), encoded(RGB, "BMP"), encoded(RGB, "JPEG2000"), encoded(EIGHT, "PPM"),
    encoded(Image.fromarray(RGB).convert("P"), "GIF"), encoded(Image.fromarray(RGB).convert("CMYK"), "TIFF"),
    encoded(257 * EIGHT.astype(np.uint16), "PPM"),
]  # fmt: skip


@pytest.mark.slow
@given(st.sampled_from(SEEDS), st.data())
@settings(max_examples=300, deadline=None)
def test_damaged_files_are_read_or_refused(seed, draw):
    """Whatever a file holds, there are grey levels of 0 .. 255, or one line that names it."""
    data = bytearray(seed)
    for _ in range(draw.draw(st.sampled_from([1, 2, 8]))):
        data[draw.draw(st.integers(0, min(len(data) - 1, 80 if draw.draw(st.booleans()) else 10**9)))] = draw.draw(
            st.sampled_from([0, 1, 127, 255])
        )
    cut = draw.draw(st.sampled_from([None, None, len(data) // 2, 20]))
    try:
        grey = decode(bytes(data[:cut]), "wall.tif").grey()
    except InputError as error:
        said = str(error)
    else:
        said = "wall.tif: "
        assert grey.size <= images.LIMIT_PX
        assert np.isfinite(grey).all()
        assert 0 <= grey.min() <= grey.max() <= 255.0001
    assert said.startswith("wall.tif: ")
    assert len(said) < 400
