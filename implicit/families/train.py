"""Train a model of a family from nothing: draw shapes, learn them, and score shapes that were not learned."""

from __future__ import annotations

import json
from os import PathLike
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.families.autodecoder import AutoDecoder, find_codes
from implicit.families.autoencoder import AutoEncoder, encode, voxels
from implicit.families.family import Family
from implicit.families.model import FAMILIES, FamilyModel
from implicit.families.samples import draw_samples
from implicit.fitting.training import Checkpoint, FitStatus, Schedule, Tell, TrainingRun
from implicit.models.checkpoints import Architecture
from implicit.models.deepsdf import DeepSdf
from implicit.models.dualsdf import DualSdf
from implicit.models.imnet import ImNet, ImNetEncoder
from implicit.models.weight_norm import with_weight_norm

FORMAT = "implicit-family-training-1"
SAMPLES = 8000  # of each training shape
VALIDATION_SEED = 1_000_003  # of the shapes that are scored, far from the seeds that users give
SPHERES = 48
VOXELS = 32  # resolution of the encoder's input


def train_family(
    family: str,
    architecture: Architecture,
    *,
    shapes: int = 400,
    latent: int = 16,
    width: int = 128,
    steps: int = 2500,
    batch: int = 9600,
    validation: int = 40,
    seed: int = 0,
    device: torch.device | str = "cpu",
    checkpoint: str | PathLike[str] | None = None,
    progress: Tell | None = None,
) -> FamilyModel:
    """Draw shapes of a family and learn them: DeepSDF and DualSDF as auto-decoders, IM-NET with its encoder.

    Args:
        family: A name out of FAMILIES.
        architecture: "deepsdf", "dualsdf" or "imnet".
        shapes: Shapes to learn.
        latent: Numbers in a code.
        width: Units in the hidden layers; of IM-NET, in its widest.
        steps: Steps of the training.
        batch: Points a step.
        validation: Further shapes, whose reconstruction is scored.
        seed: Seed of the shapes, the samples, the first weights and the batches. The same seed gives the same bits on
            the same machine with the same number of threads.
        device: Where to train; the model comes back on the CPU.
        checkpoint: A file to keep the state in; if it is there already, the training goes on from it.
        progress: Called as progress(step, steps, loss) up to 100 times.

    Raises:
        ValueError: There is no such family or architecture, a number is out of range, or the checkpoint belongs to
            another training.
    """
    if family not in FAMILIES:
        raise ValueError(f"There is no family {family!r}; there are {', '.join(FAMILIES)}.")
    if min(shapes, latent, width, steps, batch, validation) < 1:
        raise ValueError(
            "shapes, latent, width, steps, batch and validation must be at least 1, but are "
            f"{shapes}, {latent}, {width}, {steps}, {batch}, {validation}."
        )
    kind = FAMILIES[family]
    parameters = kind.draw(shapes, seed)
    generator = torch.Generator().manual_seed(seed)
    learner = _learner(kind, architecture, parameters, latent, width, batch, seed, device, generator)
    schedule = _schedule(architecture, steps)
    settings = json.dumps([family, architecture, shapes, latent, width, steps, batch, seed, str(device)])
    file = None if checkpoint is None else Checkpoint(Path(checkpoint), FORMAT, settings)
    run = TrainingRun(learner, generator, schedule, file)
    if run.train(progress) is FitStatus.DIVERGED:
        raise FloatingPointError(
            f"The loss or a weight is not finite at step {run.step}. Train again with another seed, "
            "and to a checkpoint of its own."
        )
    model = _model(kind, learner, parameters)
    scores = reconstruction_scores(model, kind.draw(validation, VALIDATION_SEED))
    model.report.update(
        {
            "family": family,
            "architecture": model.decoder.describe(),
            "shapes": shapes,
            "steps": steps,
            "batch": batch,
            "seed": seed,
            "seconds": round(run.seconds),
            "validation": summary(scores),
        }
    )
    return model


def reconstruction_scores(
    model: FamilyModel, parameters: Float[Tensor, "s p"], *, resolution: int = 64, seed: int = 0
) -> Float[Tensor, " s"]:
    """Return the intersection over union of each shape with what the model makes of it, on the cells of [-1, 1]^3.

    An auto-decoder finds the code of a shape from 4000 distances, an auto-encoder from its voxels.

    Args:
        model: The model.
        parameters: Parameters of the shapes, a row each.
        resolution: Cells along the cube.
        seed: Seed of the points whose distances are given.
    """
    codes = reconstruct(model, parameters, seed=seed)
    inside = voxels(model.family, parameters, resolution).flatten(1) > 0.5
    middles = (torch.arange(resolution) + 0.5) * (2 / resolution) - 1
    grid = model.scale * torch.stack(torch.meshgrid(middles, middles, middles, indexing="ij"), dim=-1).reshape(-1, 3)
    scores = []
    for code, truth in zip(codes, inside, strict=True):
        ours = model.field(code).value(grid) < 0
        scores.append(float((ours & truth).sum() / (ours | truth).sum()))
    return torch.tensor(scores)


def reconstruct(model: FamilyModel, parameters: Float[Tensor, "s p"], *, seed: int = 0) -> Float[Tensor, "s l"]:
    """Return codes (S, L) of shapes that the model need not have learned."""
    if model.encoder is not None:
        return encode(model.encoder, voxels(model.family, parameters, model.encoder.resolution))
    assert not isinstance(model.decoder, ImNet)
    samples = draw_samples(model.family, parameters, 4000, seed)
    return find_codes(model.decoder, samples, model.latents.mean(dim=0), seed=seed)


def summary(scores: Float[Tensor, " s"]) -> dict[str, float]:
    """Return the number of reconstruction scores, their mean and the least."""
    return {
        "shapes": len(scores),
        "mean_iou": round(float(scores.mean()), 4),
        "least_iou": round(float(scores.min()), 4),
    }


def _learner(
    family: Family,
    architecture: str,
    parameters: Tensor,
    latent: int,
    width: int,
    batch: int,
    seed: int,
    device: torch.device | str,
    generator: torch.Generator,
) -> AutoEncoder | AutoDecoder:
    samples = draw_samples(family, parameters, SAMPLES, seed).to(device)
    with torch.random.fork_rng(devices=[]):  # torch's layers draw their first weights from the global generator
        torch.manual_seed(seed)
        if architecture == "imnet":
            grids = voxels(family, parameters, VOXELS).to(device)
            decoder = ImNet(latent, max(1, width // 8)).to(device)
            encoder = ImNetEncoder(latent, 8, VOXELS).to(device)
            return AutoEncoder(decoder, encoder, samples, grids, batch)
        if architecture == "deepsdf":
            return AutoDecoder(DeepSdf(latent, width, 6, 3, weight_norm=False).to(device), samples, batch, generator)
        if architecture == "dualsdf":
            dual = DualSdf(latent, width, (3, 3), SPHERES, dropout=0.0, weight_norm=False).to(device)
            return AutoDecoder(dual, samples, batch, generator)
    raise ValueError(f"architecture must be deepsdf, dualsdf or imnet, but is {architecture!r}.")


def _schedule(architecture: str, steps: int) -> Schedule:
    # The linear layers' rate is the one that did best for ReLU networks under SOAP (implicit.fitting.fit); the codes
    # may move three times as fast, the encoder's convolutions under Adam not.
    return Schedule(steps, 3e-3, 1e-3 if architecture == "imnet" else 1e-2)


def _model(family: Family, learner: AutoEncoder | AutoDecoder, parameters: Tensor) -> FamilyModel:
    """Return the trained networks as they are published: under weight norm where that is part of the architecture."""
    modules = learner.modules()
    trained = modules["decoder"].cpu()
    encoder = modules.get("encoder")
    latents = learner.latents().cpu()
    decoder: ImNet | DeepSdf | DualSdf
    if isinstance(trained, ImNet):
        decoder = trained
    else:
        assert isinstance(trained, (DeepSdf, DualSdf))
        spread = float(latents.std(dim=0).square().mean().sqrt())
        _scale_codes(trained, spread)
        latents = latents / spread
        decoder = type(trained)(**(trained.describe()["arguments"] | {"weight_norm": True}))
        decoder.load_state_dict(with_weight_norm(trained.state_dict(), decoder))
    assert encoder is None or isinstance(encoder, ImNetEncoder)
    if encoder is not None:
        encoder.cpu().eval().requires_grad_(False)
    return FamilyModel(family, decoder.eval().requires_grad_(False), latents, parameters, encoder)


@torch.no_grad()
def _scale_codes(decoder: DeepSdf | DualSdf, factor: float) -> None:
    """Make decoder(x, z) what decoder(x, factor * z) was, by the columns that meet the code.

    Codes are given out with a spread of one, that of DualSDF's prior, so that a damping means the same in all models.
    """
    if isinstance(decoder, DeepSdf):
        heads = [(decoder.get_submodule("lin0"), decoder.get_submodule(f"lin{decoder.skip}"), decoder.latent + 3)]
    else:
        fine, coarse = decoder.deepsdf_net, decoder.prim_attr_net
        heads = [(fine.net1[0], fine.net2[0], decoder.latent + 3), (coarse.net1[0], coarse.net2[0], decoder.latent)]
    for first, again, inputs in heads:
        assert isinstance(first, nn.Linear)
        assert isinstance(again, nn.Linear)
        first.weight[:, : decoder.latent] *= factor
        start = again.in_features - inputs
        again.weight[:, start : start + decoder.latent] *= factor
