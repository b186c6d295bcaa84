"""Networks fitted to shapes, a few kilobytes each, with a report beside each; `implicit.shapes.bundled` loads them."""
