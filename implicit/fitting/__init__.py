"""Networks fitted to samples of a signed distance."""
