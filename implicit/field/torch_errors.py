"""Errors of torch about a module that it cannot take, in words that name the module's part in it and what to do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

# A piece of torch's message, in small letters, and what it means for the owner of the module. The first that fits.
_MEANINGS = (
    ("checkpoint", "Its activations are checkpointed, that is computed again later with the parameters of then: turn "
     "gradient checkpointing off, which a field does not need"),
    ("recomput", "Its activations are checkpointed: turn gradient checkpointing off, which a field does not need"),
    ("marked with @once_differentiable", "An autograd.Function in it is once_differentiable: write its backward of "
     "differentiable operations, or take what needs no second derivatives"),
    ("setup_context", "An autograd.Function in it is of the old style, with ctx in forward: give it setup_context and "
     "generate_vmap_rule = True"),
    ("generate_vmap_rule", "An autograd.Function in it says nothing of vmap: give it generate_vmap_rule = True"),
    ("donated buffer", "A compiled part in it frees what a second pass needs: give the module that was compiled, "
     "module._orig_mod, or compile it with torch._functorch.config.donated_buffer = False"),
    ("is not supported on compiled", "A compiled part in it cannot be transformed: give the module that was compiled"),
    ("dynamo", "A compiled part in it cannot be transformed: give the module or function that was compiled"),
    ("torch.compile", "A compiled part in it cannot be transformed: give the module or function that was compiled"),
    ("inference tensor", "It runs or was made under torch.inference_mode: load and call it outside of that"),
    ("does not support double backward", "An operation in it has no second derivative: take one of plain torch, or "
     "what needs no second derivatives"),
    ("derivative for", "An operation in it has no derivative of that kind: take one of plain torch"),
    ("does not require grad", "Its values are cut off from their argument: remove detach(), .data, numpy and no_grad "
     "from forward"),
    ("appears to not have been used", "Its values are cut off from their argument: remove detach(), .data, numpy and "
     "no_grad from forward"),
    ("calling tensor.requires_grad_", "Its forward calls requires_grad_() on its points, and so cuts them off: remove "
     "that line"),
    ("same dtype", "It holds numbers of another precision where no copy reaches them, such as a global: register them "
     "as buffers, or use .to(points.dtype) in forward"),
    ("expected scalar type", "It holds numbers of another precision where no copy reaches them, such as a global: "
     "register them as buffers, or use .to(points.dtype) in forward"),
    ("on the same device", "It holds numbers on another device where no copy reaches them, such as a global: register "
     "them as buffers, or use .to(points.device) in forward"),
    ("meta tensor", "Some of it is on the meta device and holds no numbers: load it to the CPU or a GPU"),
    ("inplace", "It changes tensors in place: write a = a + b in place of a += b"),
    ("in-place", "It changes tensors in place: write a = a + b in place of a += b"),
    ("positional argument", "Its forward takes other arguments than points alone: give inputs=, a function from points "
     "(N, D) to the argument or the tuple of arguments, or decoder_field for a decoder with a code"),
)  # fmt: skip


def meaning(error: BaseException) -> str:
    """Return what an error of torch means for the owner of a module, a sentence, or "" where that is not known."""
    text = str(error).lower()
    return next((f"{words}." for piece, words in _MEANINGS if piece in text), "")


def first_line(error: BaseException) -> str:
    """Return the type of an error and the first line of what it says, at most 200 characters."""
    line = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
    return f"{type(error).__name__}: {line[:200]}".rstrip(": .")


def refusal(doing: str, error: BaseException) -> TypeError:
    """Return the error that a user sees when torch fails at something, such as "be evaluated at points (8, 3)"."""
    hint = meaning(error) or "Evaluate it alone at such points to see where, or wrap it in a module that can."
    return TypeError(f"The module or decoder could not {doing} ({first_line(error)}). {hint}")


class ModuleError(TypeError):
    """Failure of a user's module or of torch, in our words; it passes through further calls as it is."""


@contextmanager
def in_our_words(doing: str) -> Iterator[None]:
    """Run a part whose errors come from a user's module or from torch, and refuse those in our words.

    Args:
        doing: What the module was to do, after "could not", such as "be differentiated by the points".

    Raises:
        TypeError: In place of any error but want of memory, which is raised as it is.
    """
    try:
        yield
    except (ModuleError, MemoryError):
        raise
    except Exception as error:
        if is_memory(error):
            raise
        raise ModuleError(str(refusal(doing, error))) from error


def is_memory(error: BaseException) -> bool:
    """Return whether an error of torch says that memory has run out: nothing of the module, then."""
    return isinstance(error, MemoryError) or "out of memory" in str(error) or "can't allocate memory" in str(error)
