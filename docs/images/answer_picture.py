"""The picture of an answer in the README, from the page of a diagnosis: where the gap lies, before and after its
cause is known, and which cause that is.

python docs/images/answer_picture.py diagnosis.html docs/images/answer.png
"""

from __future__ import annotations

import base64
import io
import re
import sys
from pathlib import Path

from PIL import Image

MAP, CAUSE, LOOPS = "Gap by spine length", "Probability of each", "Sideways gap up and down"
WIDTH, GAP = 1600, 24
FIGURE = re.compile(r'<img alt="([^"]*)" src="data:image/png;base64,([^"]*)">')


def main(page: Path, picture: Path) -> None:
    """Put the three figures side by side: the map left, the two others in a column."""
    figures = {}
    for caption, data in FIGURE.findall(page.read_text(encoding="utf-8")):
        figures.setdefault(caption, Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))
    states, cause, loops = (
        next(image for caption, image in figures.items() if caption.startswith(word)) for word in (MAP, CAUSE, LOOPS)
    )
    right = [wide(image, (WIDTH - GAP) * 9 // 20) for image in (loops, cause)]
    left = wide(states, (WIDTH - GAP) * 11 // 20)
    height = max(left.height, sum(image.height for image in right) + GAP)
    whole = Image.new("RGB", (WIDTH, height), "white")
    whole.paste(left, (0, (height - left.height) // 2))
    whole.paste(right[0], (left.width + GAP, 0))
    whole.paste(right[1], (left.width + GAP, right[0].height + GAP))
    whole.quantize(256).save(picture, optimize=True)


def wide(image: Image.Image, width: int) -> Image.Image:
    """The image at this width."""
    return image.resize((width, round(image.height * width / image.width)), Image.Resampling.LANCZOS)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
