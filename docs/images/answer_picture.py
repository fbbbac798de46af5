"""The pictures of an answer in the README and in the first day: the top of the page of a diagnosis, as Chromium shows it.

python docs/images/answer_picture.py demo/report.html docs/images/answer.png
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

WIDTH, HEIGHT = 1000, 1185
"""Of the page, px: its first sentence and the gap step by step."""


def main(page: Path, picture: Path) -> None:
    """Screenshot, cut and reduced to 256 colours."""
    with tempfile.TemporaryDirectory() as place:
        shot = Path(place, "page.png")
        command = [
            "chromium",
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            f"--user-data-dir={place}",
        ]
        command += [f"--window-size={WIDTH},{2 * HEIGHT}", f"--screenshot={shot}", page.resolve().as_uri()]
        subprocess.run(command, check=True, capture_output=True)
        whole = Image.open(io.BytesIO(shot.read_bytes())).convert("RGB")
    whole.crop((0, 0, WIDTH, HEIGHT)).quantize(256).save(picture, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
