"""Picture and movie files: sRGB encoding, metadata that describes the picture, atomic writing."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from clacad.base.types import Bytes, Floats
from clacad.rendering.picture import Picture
from clacad.rendering.sheet_passage import Passage
from clacad.scene import Scene
from clacad.storage.atomic import write_file

STILLS = (".png", ".webp", ".tiff", ".tif")
MOVIES = (".webp", ".png", ".apng", ".gif", ".mp4")

MIRRORED = "mirror image: the part made from this design shows the view flipped left-right"
NOT_SIMULATED = (
    "coherence between telescopelets, vector diffraction, stress birefringence, index of air: not simulated"
)


class UnknownPicture(ValueError):
    """A file name with the ending of no supported format; exit status 2."""

    exit_status = 2


def encode(light: Floats, exposure: float = 1.0, encoding: str = "srgb") -> Bytes:
    """Bytes of linear light: times exposure, clipped to 0 … 1, sRGB (IEC 61966-2-1) unless "linear"."""
    value = np.clip(light * exposure, 0.0, 1.0)
    if encoding == "srgb":
        value = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1.0 / 2.4) - 0.055)
    return np.rint(255.0 * value).astype(np.uint8)


def metadata_of(picture: Picture) -> dict[str, str]:
    """Metadata of a picture, by key."""
    scene = picture.scene
    found = {
        "Title": scene.name,
        "Software": _version(),
        "clacad:design": _of_sheets(scene, [f"{one.name} sha256 {one.sha256}" for one in scene.designs()]),
        "clacad:rung": _of_sheets(scene, [_rung_text(one) for one in _passages(picture)]),
        "clacad:effects": _of_sheets(scene, [_effect_text(one) for one in _passages(picture)]),
        "clacad:samples": f"{int(picture.samples.min())} to {int(picture.samples.max())} rays a pixel",
        "clacad:encoding": scene.camera.encoding,
        "clacad:handedness": MIRRORED if scene.camera.mirror else "as seen by a camera before the part",
        "clacad:left-out": (
            NOT_SIMULATED
            if len(scene.sheets) == 1
            else f"light sent back and forth between sheets, {NOT_SIMULATED}"
        ),
    }
    blocks = [f"{name} in blocks of {side} x {side} pixels" for name, side in picture.blockwise]
    return {**found, "clacad:coarse": ", ".join(blocks)} if blocks else found


def _passages(picture: Picture) -> list[Passage]:
    """Passages of all sheets."""
    return [one.passage for one in picture.passage.several] or [picture.passage]


def _of_sheets(scene: Scene, said: list[str]) -> str:
    """Texts of all sheets, by id where there are several; the first alone where the others have none."""
    if len(scene.sheets) == 1 or len(said) == 1:
        return said[0]
    return "; ".join(f"{sheet.id}: {text}" for sheet, text in zip(scene.sheets, said, strict=True))


def _rung_text(passage: Passage) -> str:
    return passage.rung if passage.plan is None else f"{passage.rung} ({passage.plan.rung_why})"


def _effect_text(passage: Passage) -> str:
    return "none" if passage.plan is None else passage.plan.summary()


def _version() -> str:
    from clacad import __version__

    return f"clacad {__version__}"


def pixels_of(picture: Picture) -> Bytes:
    """Encoded bytes (h, w, 3) with the exposure and encoding of the scene's camera."""
    camera = picture.scene.camera
    return encode(picture.light, camera.exposure, camera.encoding)


def write_picture(picture: Picture, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write a still as PNG, WebP (lossless) or TIFF, by the name's ending, with its metadata.

    Raises UnknownPicture, CannotWrite, ExportRefused.
    """
    target = Path(path)
    if target.suffix.lower() not in STILLS:
        raise UnknownPicture(f"{target.name}: a picture is one of {' '.join(STILLS)}")
    write_file(
        target, lambda private: save(pixels_of(picture), private, metadata_of(picture)), overwrite=overwrite
    )


def save(pixels: Bytes, path: Path, notes: dict[str, str]) -> None:
    """Write encoded pixels with metadata, format by the name's ending."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    image = Image.fromarray(pixels)
    kind = path.suffix.lower()
    if kind == ".png":
        info = PngInfo()
        for key, value in notes.items():
            info.add_itxt(key, value) if not value.isascii() else info.add_text(key, value)
        image.save(path, pnginfo=info, optimize=True)
    elif kind == ".webp":
        image.save(path, lossless=True, quality=100, method=6, exif=_exif(notes))
    else:
        image.save(path, compression="tiff_adobe_deflate", description=_one_text(notes))


def _exif(notes: dict[str, str]) -> Any:
    from PIL import Image

    made = Image.Exif()
    made[0x010E] = _one_text(notes)  # ImageDescription
    made[0x0131] = notes.get("Software", "")
    return made


def _one_text(notes: dict[str, str]) -> str:
    return "\n".join(f"{key}: {value}" for key, value in notes.items())


def labelled(pixels: Bytes, text: str, lines: int = 1) -> Bytes:
    """A picture with its label on a strip below it, broken into lines that fit.

    pixels : (h, w, 3) bytes
    lines : Least number of lines that the strip has room for: frames of a movie must have equal heights.
    """
    from PIL import Image, ImageDraw

    size, font = _label_font(pixels.shape[1])
    broken = label_lines(text, pixels.shape[1])
    pitch = 2 * size - 2 if max(lines, len(broken)) == 1 else round(1.3 * size)
    height = max(lines, len(broken)) * pitch + (0 if pitch == 2 * size - 2 else size // 2)
    strip = Image.new("RGB", (pixels.shape[1], height), (255, 255, 255))
    draw = ImageDraw.Draw(strip)
    for k, line in enumerate(broken):
        draw.text((size // 2, size // 4 + k * pitch), line, fill=(40, 40, 40), font=font)
    return np.concatenate([pixels, np.asarray(strip)])


def label_lines(text: str, width: int) -> list[str]:
    """A label broken between words, but not at " = ", to lines that fit below a picture (pixels wide)."""
    size, font = _label_font(width)
    lines = [""]
    for word in text.replace(" = ", "\0=\0").split():
        longer = f"{lines[-1]} {word}".strip().replace("\0", " ")
        if lines[-1] and font.getlength(longer) > width - size:
            lines.append(word.replace("\0", " "))
        else:
            lines[-1] = longer
    return lines


def _label_font(width: int) -> tuple[int, Any]:
    """Size and font of a label below a picture of `width` pixels."""
    from PIL import ImageFont

    size = max(10, min(14, width // 32))
    return size, ImageFont.load_default(size)


def write_movie(
    frames: Iterable[Picture], path: str | os.PathLike[str], fps: float, *, overwrite: bool = False
) -> list[dict[str, Any]]:
    """Write frames as an animation: WebP, PNG, GIF, or MP4 where the encoder is installed.

    Returns: For each frame: rung and rays traced.
    Raises UnknownPicture: Another ending, or MP4 without an encoder.
    Raises CannotWrite, ExportRefused.
    """
    target = Path(path)
    kind = target.suffix.lower()
    if kind not in MOVIES:
        raise UnknownPicture(f"{target.name}: a movie is one of {' '.join(MOVIES)}")
    writer = _mp4_writer() if kind == ".mp4" else None
    told: list[dict[str, Any]] = []
    notes: dict[str, str] = {}

    def pixels() -> Iterator[Bytes]:
        for picture in frames:
            told.append({"rung": picture.passage.rung, "rays": int(picture.samples.sum())})
            notes.update(metadata_of(picture))
            yield pixels_of(picture)

    def write(private: Path) -> None:
        if writer is not None:
            writer(private, pixels(), fps)
        else:
            animate(private, pixels(), fps, notes)

    write_file(target, write, overwrite=overwrite)
    return told


def animate(path: Path, frames: Iterator[Bytes], fps: float, notes: dict[str, str]) -> None:
    """Write encoded frames as WebP, GIF or PNG."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    images = [Image.fromarray(pixels) for pixels in frames]
    first, rest = images[0], images[1:]
    common: dict[str, Any] = {"save_all": True, "append_images": rest, "duration": 1000.0 / fps, "loop": 0}
    kind = path.suffix.lower()
    if kind == ".webp":
        common["duration"] = round(1000.0 / fps)
        first.save(path, **common, quality=80, method=4, exif=_exif(notes))
    elif kind == ".gif":
        first.save(path, **common, disposal=1)
    else:
        info = PngInfo()
        for key, value in notes.items():
            info.add_itxt(key, value)
        first.save(path, format="PNG", **common, pnginfo=info)


def _mp4_writer() -> Any:
    """A function (path, frames, fps) that writes H.264, from the optional extra.

    Raises UnknownPicture: The encoder is not installed.
    """
    from importlib import import_module

    try:
        write_frames = import_module("imageio_ffmpeg").write_frames
    except ImportError:
        raise UnknownPicture(
            "MP4 needs an encoder: pip install 'clacad[movies]', or write .webp, .png or .gif"
        ) from None

    def write(path: Path, frames: Iterator[Bytes], fps: float) -> None:
        first = next(frames)
        height, width = first.shape[0] // 2 * 2, first.shape[1] // 2 * 2
        stream = write_frames(str(path), (width, height), fps=fps, quality=7, macro_block_size=2)
        stream.send(None)
        stream.send(np.ascontiguousarray(first[:height, :width]))
        for pixels in frames:
            stream.send(np.ascontiguousarray(pixels[:height, :width]))
        stream.close()

    return write
