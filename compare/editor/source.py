"""The shape that an editing session begins with: whatever the user names, as a field in 3D.

| named | is |
|---|---|
| spot | a bundled shape |
| deepsdf-chairs | a bundled family model: the shape of one of its codes, whose code is edited |
| bunny.obj, part.stl, ... | a mesh, to which a field is fitted |
| bunny.safetensors | a field, a family model, or a published network or decoder with its codes |
| net.pt, net.pth, net.ckpt | a published network, or a decoder with its codes |
| my_module.py:make_field | what a function of the user's own returns: a Field, or a torch module |
"""

from __future__ import annotations

import difflib
from dataclasses import asdict, dataclass, field as default
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compare.cases.case import BUNDLED, FIELD_SUFFIX, MESH_SUFFIXES
from compare.errors import InputError, Progress
from compare.fitting.mending import Mending
from compare.runs.subject import load_mesh

if TYPE_CHECKING:
    from implicit import Field
    from implicit.families import FamilyModel

CHECKPOINTS = (".pt", ".pth", ".ckpt")


@dataclass(frozen=True)
class Opening:
    """Options of how a shape is taken in.

    Attributes:
        code: Number of the code, from 0, of a shape that a decoder generates.
        module: What builds the network of a field's file, "my_nets.py:make"; None where it needs nothing.
        fit: Options of compare.fit_mesh, for a mesh.
    """

    code: int = 0
    module: str | None = None
    fit: dict[str, Any] = default(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Source:
    """A shape that was taken in.

    Attributes:
        shape: As the user named it.
        opening: How it was taken in.
        field: The field, not edited yet.
        kind: "bundled", "family", "mesh", "field", "checkpoint" or "code".
        codes: Codes (S, L) of the shapes that the decoder was trained on; None for fields whose code is not edited.
        notes: What a reader should know, a sentence each.
    """

    shape: str
    opening: Opening
    field: Field
    kind: str
    codes: Any = None
    notes: tuple[str, ...] = ()


def open_source(shape: str, opening: Opening | None = None, progress: Progress | None = None) -> Source:
    """Take in what the user names.

    Args:
        shape: A name or a file, see the table above.
        opening: How it is taken in.
        progress: Called as progress(step, steps, what) while a field is fitted to a mesh.

    Raises:
        InputError: It is nothing of that, or cannot be used.
    """
    opening = Opening() if opening is None else opening
    if not isinstance(shape, str) or not shape:
        raise InputError(f"A shape must be a name or a file, but is {shape!r}.")
    try:
        source = _opened(shape, opening, progress)
    except InputError:
        raise
    except (ValueError, TypeError, OSError) as error:
        text = str(error)
        raise InputError(text if shape in text else f"{shape}: {text}") from error
    if source.field.dimension != 3:
        raise InputError(f"{shape} is a field in {source.field.dimension} dimensions, but the editor needs 3.")
    return source


def _opened(shape: str, opening: Opening, progress: Progress | None) -> Source:
    from implicit import families, shapes

    suffix = Path(shape).suffix.lower()
    if opening.module is not None and suffix != FIELD_SUFFIX:
        raise InputError(f"A module builds the network of a {FIELD_SUFFIX}, but the shape is {shape}. Leave it out.")
    if shape in BUNDLED:
        return Source(shape, opening, shapes.bundled(shape), "bundled")
    if shape in families.BUNDLED:
        return _of_family(shape, opening, families.bundled(shape))
    if ":" in shape and not Path(shape).exists():
        return _of_code(shape, opening)
    if suffix not in (*MESH_SUFFIXES, FIELD_SUFFIX, *CHECKPOINTS):
        close = difflib.get_close_matches(shape, (*BUNDLED, *families.BUNDLED), n=1)
        hint = f" Did you mean {close[0]}?" if close else ""
        raise InputError(
            f"A shape is one of {', '.join((*BUNDLED, *families.BUNDLED))}, a file ending in "
            f"{', '.join((*MESH_SUFFIXES, FIELD_SUFFIX, *CHECKPOINTS))}, or a function of yours, "
            f"my_module.py:make_field, but got {shape!r}.{hint}"
        )
    if not Path(shape).is_file():
        raise InputError(f"There is no file {shape}. Check the path; bundled shapes are {', '.join(BUNDLED)}.")
    if suffix in MESH_SUFFIXES:
        return _of_mesh(shape, opening, progress)
    return _of_tensors(shape, opening)


def _of_family(shape: str, opening: Opening, model: FamilyModel) -> Source:
    code = _code(shape, opening.code, len(model.latents))
    return Source(shape, opening, model.field(model.latents[code]), "family", model.latents)


def _of_mesh(shape: str, opening: Opening, progress: Progress | None) -> Source:
    from compare.fitting.fit import fit_mesh

    mending = Mending(**{name: opening.fit[name] for name in ("bodies", "hole_limit") if name in opening.fit})
    V, F, notes = load_mesh(shape, mending, progress=progress)

    def tell(step: int, steps: int, _: Any) -> None:
        if progress is not None:
            progress(step, steps, "fitting a field")

    fitted, report = fit_mesh(V, F, progress=tell, **{**opening.fit, **asdict(mending)})
    return Source(shape, opening, fitted, "mesh", None, (*notes, f"The fit: {report.verdict}"))


def _of_tensors(shape: str, opening: Opening) -> Source:
    import implicit
    from implicit import families

    kind = _kind_of(shape)
    if kind == "field":
        return Source(shape, opening, implicit.load_field(shape, module=opening.module), "field")
    if kind == "family":
        return _of_family(shape, opening, families.load_model(shape))
    try:
        return Source(shape, opening, implicit.load_network(shape), "checkpoint")
    except ValueError as of_network:
        try:
            decoder, codes = implicit.load_checkpoint(shape, "auto")
        except ValueError as of_decoder:
            raise InputError(f"{shape} is no known network ({of_network}), nor a decoder ({of_decoder}).") from (
                of_decoder
            )
    code = _code(shape, opening.code, len(codes))
    return Source(shape, opening, implicit.decoder_field(decoder, codes[code]), "checkpoint", codes)


def _kind_of(shape: str) -> str:
    """Return "field" or "family" for a file that says so of itself, else "checkpoint"."""
    from safetensors import SafetensorError, safe_open

    if Path(shape).suffix.lower() != FIELD_SUFFIX:
        return "checkpoint"
    try:
        with safe_open(shape, framework="pt") as file:
            says = file.metadata() or {}
    except SafetensorError:
        return "field"  # whose reader says what is wrong with the file
    return next((kind for kind in ("field", "family") if kind in says), "checkpoint")


def _of_code(shape: str, opening: Opening) -> Source:
    from torch import nn

    from implicit import Field
    from implicit.models.named_code import named_function

    made = named_function(shape)()
    if isinstance(made, nn.Module):
        made = Field(made)
    if not isinstance(made, Field):
        raise InputError(f"{shape} must return an implicit.Field or a torch module, but gave a {type(made).__name__}.")
    return Source(shape, opening, made, "code")


def _code(shape: str, code: int, count: int) -> int:
    if not 0 <= code < count:
        there = f"codes 0 to {count - 1}" if count else "no codes"
        raise InputError(f"{shape} has {there}, but code {code} is wanted.")
    return code
