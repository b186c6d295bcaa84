"""Cost and accuracy side by side, for asv: `time_`, `peakmem_` with an empty baseline, and `track_` for errors."""
