"""Fields fitted to meshes, the fields that come with the package, and families trained."""
