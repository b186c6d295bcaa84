"""A study of your own

How many points does an edit need? A grid of settings, edited as field and as mesh, with a row each and a curve.
"""

import csv
import shutil
from pathlib import Path

import compare

# %%
# A study is a file of settings: which shapes, which operations, which values of what.
Path("points.toml").write_text("""
title = "Points of a geometric edit"
shapes = ["cactus"]
operations = ["geometric"]

[settings]
vertices = 500
resolution = 24
implicit.steps = 2

[grid]
implicit.points = [100, 200, 400]

[[charts]]
x = "implicit.points"
y = "error_relative"
""")

# %%
# It may be cut off at any moment and goes on where it was; `executor=compare.Workers(4)` spreads it over processes.
records = compare.run_study("points.toml", "points-study")
print(len(records), "cases;", sorted(path.name for path in Path("points-study").iterdir()))

# %%
# Every case is a row of results.jsonl, and a line for each side in table.csv: pandas.read_csv reads it too.
with open("points-study/table.csv", newline="") as file:
    for line in csv.DictReader(file):
        error, energy = float(line["error_relative"]), float(line["killing_energy"])
        print(f"{line['implicit.points']} points, {line['by']}: normal error {error:.3f}, Killing energy {energy:.3f}")

shutil.copy("points-study/chart.png", "own_study.png")
