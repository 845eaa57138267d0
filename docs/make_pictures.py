"""Draw the README's picture, from the paper's experiment, and that of the page on calibration.

`make pictures` runs it (needs Chromium).
"""

import io
import runpy
import shutil
from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from playwright.sync_api import sync_playwright

import harness
from harness.report import calibration_figures, theme
from harness.report.method_styles import methods_of
from harness.report.sections import profiles, scene_to_panorama
from harness.runs.load import load_experiment
from harness.runs.run import run_experiment

DOCS = Path(__file__).parent
PAGE = """<body style="margin:0;background:white"><div id="all" style="width:1080px;padding:12px">
<div style="display:flex;justify-content:space-between;align-items:center">{top}</div>{rest}</div></body>"""


def main() -> None:
    """Run the experiment, lay the report's own figures out on a page, and photograph it."""
    outcomes = run_experiment(load_experiment("paper")).outcomes
    methods = methods_of(outcomes)
    with theme.style():
        top = [scene_to_panorama.environment(outcomes[0]), scene_to_panorama.mirror_image(outcomes[0])]
        row = profiles.row_at(methods, profiles.main_row(methods))
        span = profiles.limits(methods, row.index)
        rest = [profiles.profile(method, row, span, letter) for method, letter in zip(methods, "ab", strict=True)]
    _photograph(PAGE.format(top="".join(map(_image, top)), rest="".join(map(_image, rest))), "paper")


def calibration() -> None:
    """Calibrate from the boards of the how-to page, and lay out two of its page's figures."""
    with TemporaryDirectory() as folder, chdir(folder):
        runpy.run_path(str(DOCS / "how-to" / "files" / "board_images.py"))
        board = {"columns": 9, "rows": 6, "square_m": 0.04}
        found = harness.calibrate(sorted(Path("boards").glob("*.png")), board=board, model="hyperboloid")
    with theme.style():
        figures = [calibration_figures.coverage_map(found), calibration_figures.ray_map(found)]
    _photograph(PAGE.format(top="".join(map(_image, figures)), rest=""), "calibration")


def _photograph(page_text: str, name: str) -> None:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(device_scale_factor=1.5)
        page.set_content(page_text)
        shot = page.locator("#all").screenshot()
        browser.close()
    # Greys and a few colours: a palette halves the file.
    Image.open(io.BytesIO(shot)).convert("RGB").quantize(128, dither=Image.Dither.NONE).save(
        DOCS / "images" / f"{name}.png", optimize=True
    )


def _image(picture: theme.Picture) -> str:
    return f'<img src="{picture.source}" width="{picture.width}" height="{picture.height}" alt="">'


if __name__ == "__main__":
    main()
    calibration()
