"""The function: a field f(x; theta) with its evaluation, and the decoders that take a code."""
