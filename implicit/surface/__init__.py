"""The surface f(x; theta) = 0: the mesh, projection onto it, quadrature, samples, pieces and soundness."""
