"""Calibrations of real cameras, in the folder that OMNIRANGE_REAL names; skipped where it is not set."""

import os
from pathlib import Path

import numpy as np
import pytest

from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.model_fitting import Target, convert
from harness.camera.models import MODELS
from harness.camera.optics import Optics
from harness.errors import InputError
from harness.io.calibrations import FORMATS, read_calibration
from harness.io.calibrations.ocamcalib import inverse_radius
from harness.io.calibrations.parsing import read_content

FOLDER = os.environ.get("OMNIRANGE_REAL")
pytestmark = pytest.mark.skipif(FOLDER is None, reason="OMNIRANGE_REAL names no folder of real calibrations")
REAL = Path(FOLDER or ".")


def optics_of(camera):
    width, height = camera.size
    return Optics(
        MODELS[camera.model["kind"]].model_validate(camera.model),
        Camera.model_validate(camera.camera | {"width_px": width, "height_px": height}),
        Lens.model_validate(camera.lens),
    )


def ocam_text(table):
    """OCamCalib's text of a camera in the rig's file."""
    lines = [
        " ".join(f"{each:g}" if i == 0 else repr(each) for i, each in enumerate(table[name]))
        for name in ("poly", "inv_poly")
    ]
    lines += [" ".join(map(repr, table[name])) for name in ("center", "affine", "image_size")]
    return "\n\n".join(f"#{i}\n\n{line}" for i, line in enumerate(lines))


def by_inverse(content_text, rays):
    """Pixels by the file's own inverse polynomial, of rays in our frame."""
    words = " ".join(line for line in content_text.splitlines() if not line.startswith("#")).split()
    values = [float(word) for word in words]
    direct = int(values[0])
    count = int(values[1 + direct])
    inverse = np.array(values[2 + direct : 2 + direct + count])
    row, column, c, d, e = values[2 + direct + count : 7 + direct + count]
    x, y, z = rays[:, 1], rays[:, 0], -rays[:, 2]
    across = np.hypot(x, y)
    rho = inverse_radius(inverse, np.arctan2(z, across))
    x, y = rho * x / across, rho * y / across
    return np.stack([e * x + y + column, c * x + d * y + row], axis=-1)


@pytest.mark.parametrize(("name", "most_px"), [("ocam_fisheye", 0.05), ("ocam_omniunwarp_mirror", 0.1)])
def test_the_files_own_inverse_polynomial_agrees(name, most_px):
    """It was fitted by OCamCalib to hundredths of a pixel, and has the direction's other way round."""
    path = REAL / "calib" / f"{name}.txt"
    (camera,) = read_calibration(path).cameras
    optics = optics_of(camera)
    rng = np.random.default_rng(0)
    pixels = rng.uniform(0, np.array(camera.size) - 1, (2000, 2))
    assert np.abs(by_inverse(path.read_text(), optics.unproject(pixels)) - pixels).max() < most_px


def test_the_polynomials_of_a_rig(tmp_path):
    """Its inverse polynomials are another fit, which is 3 px off in places within the 220° of the lens: as is said."""
    for i, table in enumerate(read_content(REAL / "itbt" / "config.yaml").data["cameras"]):
        path = tmp_path / f"{i}.txt"
        path.write_text(ocam_text(table))
        (camera,) = read_calibration(path).cameras
        assert camera.size == (1600, 1532)
        optics = optics_of(camera)
        v, u = np.mgrid[0:1532:20, 0:1600:20]
        pixels = np.stack([u.ravel(), v.ravel()], axis=-1).astype(float)
        rays = optics.unproject(pixels)
        seen = rays[:, 2] > np.cos(np.radians(table["max_fov"] / 2))
        apart = np.linalg.norm(by_inverse(path.read_text(), rays[seen]) - pixels[seen], axis=-1)
        assert np.sqrt(np.mean(apart**2)) < 4
        assert camera.notes[0].endswith("gives programs that project with it other pixels")
        # In Kannala and Brandt's model, where its affine part is next to nothing, and back in rays.
        found = convert(optics, pixels[seen], Target("kannala_brandt"))
        assert found.rms_px < (0.5 if abs(camera.model["d"]) < 1e-3 else 30)


def test_corners_for_a_calibration_are_no_calibration():
    with pytest.raises(InputError, match=r"camera_matrix: this key is missing \(or K\); there are: imagePoints"):
        read_calibration(REAL / "calib" / "omni_calib_data.xml")


@pytest.mark.parametrize("kind", ["unified", "kannala_brandt", "double_sphere", "eucm"])
def test_a_real_mirror_in_other_models(kind):
    """The mirror's image lies between 235 and 600 px from the centre in the file's own remark."""
    (camera,) = read_calibration(REAL / "calib" / "ocam_omniunwarp_mirror.txt").cameras
    optics = optics_of(camera)
    v, u = np.mgrid[0:1080:10, 0:1300:10]
    pixels = np.stack([u.ravel(), v.ravel()], axis=-1).astype(float)
    rho = np.linalg.norm(pixels - [optics.camera.cx_px, optics.camera.cy_px], axis=-1)
    found = convert(optics, pixels[(rho > 235) & (rho < 535)], Target(kind))
    assert found.rms_px < 0.4
    written = FORMATS["opencv" if kind in ("unified", "kannala_brandt") else "kalibr"]
    assert written.write(found.optics)
