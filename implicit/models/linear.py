"""Linear layers whose numbers are still to be written."""

import torch
from torch import nn


def unset_linear(inputs: int, outputs: int) -> nn.Linear:
    """Return a linear layer with weights and biases of any value, drawing nothing from the global generator.

    As torch.nn.utils.skip_init, whose way from the meta device to memory imports sympy: more than a second of every
    process that loads a field.
    """
    layer = nn.Linear(inputs, outputs, device="meta")
    layer.weight = nn.Parameter(torch.empty(outputs, inputs))
    layer.bias = nn.Parameter(torch.empty(outputs))
    return layer
