"""Run scripts of the gallery, keep their pictures and what they print: python docs/site/draw_gallery.py [NAME ...]

Each runs in an empty folder of its own. The picture, as NAME.webp, and the text NAME.txt go beside the script, to be
looked at and committed; the site shows them and runs nothing.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

GALLERY = Path(__file__).resolve().parent.parent / "gallery"
SCRIPTS = sorted(path for path in GALLERY.glob("*.py"))


def run(script: Path, folder: Path, *, timeout: float = 600.0) -> str:
    """Run a script in a folder and return what it printed.

    Raises:
        RuntimeError: It failed, with all that it printed, or it left no picture.
    """
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=folder,
        capture_output=True,
        text=True,
        env=environment,
        timeout=timeout,
        check=False,
    )
    if done.returncode != 0:
        raise RuntimeError(f"{script.name} failed:\n{done.stdout}\n{done.stderr}")
    picture = folder / f"{script.stem}.png"
    if not picture.is_file() or picture.stat().st_size < 5000:
        raise RuntimeError(f"{script.name} drew no {picture.name}.")
    return done.stdout


def main() -> None:
    """Run those named, or all."""
    chosen = [script for script in SCRIPTS if not sys.argv[1:] or script.stem in sys.argv[1:]]
    failed = []
    for script in chosen:
        began = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        with tempfile.TemporaryDirectory() as folder:
            try:
                text = run(script, Path(folder))
            except RuntimeError as error:
                failed.append(str(error))
                continue
            with Image.open(Path(folder) / f"{script.stem}.png") as picture:  # a quarter of the size
                picture.convert("RGB").save(GALLERY / f"{script.stem}.webp", quality=88, method=6)
        (GALLERY / f"{script.stem}.txt").write_text(text, encoding="utf-8")
        of_processor = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - began[1]
        print(f"{script.stem}: {time.perf_counter() - began[0]:.0f} s, {of_processor:.0f} s of processor", flush=True)
    if failed:
        sys.exit("\n\n".join(failed))


if __name__ == "__main__":
    main()
