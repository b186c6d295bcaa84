"""Families of parametric shapes, with what it takes to learn them and models that come with the package."""
