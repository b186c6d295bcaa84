"""A session without a browser: previews are the linear model, and edits can be taken back, kept and repeated."""

import json
import math
import runpy
import shutil

import numpy as np
import pytest
import torch

import implicit
import implicit.shapes
from compare import run_case
from compare.cases.handles_file import read_handles
from compare.editor import CalledOffError, EditSession, Motion, Opening, Settings, ball, half_space, linear
from compare.editor.exports import case_of, export_handles, script
from compare.editor.regions import box, brush
from compare.editor.session import Measured
from compare.errors import InputError

EVERYTHING = ball([0.0, 0.0, 0.0], 2.0, 0.0)
TIP = ball([0.3, 0.0, 0.25], 0.15, 0.2)


def moved(session):
    session.pick(TIP)
    return session.drag(Motion(translation=(0.04, 0.01, 0.0)))


def test_a_sphere_dragged_as_a_whole_moves_its_centre_by_the_drag(sphere):
    start = sphere.field.theta
    sphere.pick(EVERYTHING)
    drag = np.array([0.05, -0.03, 0.02])
    frame = sphere.preview(Motion(translation=tuple(drag)))
    out = ((frame.V - sphere.surface.V) * sphere.surface.N).sum(axis=1)
    np.testing.assert_allclose(out, sphere.surface.N @ drag, atol=2e-5)
    assert frame.missed.share < 1e-3
    entry = sphere.drag(Motion(translation=tuple(drag)))
    centre = dict(sphere.field.module.named_parameters())["center"]
    np.testing.assert_allclose(centre.detach().numpy(), drag, atol=1e-4)
    assert (sphere.field.theta - start).norm() == pytest.approx(np.linalg.norm(drag), abs=1e-4)
    assert entry.done
    assert entry.numbers["missed"] < 0.01


def test_a_sphere_scaled_about_its_centre_takes_the_factor_for_its_radius(sphere):
    sphere.pick(EVERYTHING, grip=(0.0, 0.0, 0.0))
    sphere.drag(Motion(factor=1.1))
    assert sphere.measures()["volume"] == pytest.approx(4 / 3 * math.pi * 0.55**3, rel=1e-4)


def test_the_preview_is_the_linear_model_of_the_rows(bulb):
    """Against the primal normal equations in the parameters, three parts as in implicit.expressibility."""
    bulb.pick(TIP)
    motion = Motion(translation=(0.01, 0.0, 0.005), factor=1.05)
    model = bulb.prepare()
    points, normals, weights = model.sample.points, model.sample.normals, model.sample.weights
    handle = motion.spec(bulb.regions[0]).build()
    target = handle.weights(points) * ((handle.position(1.0, points, normals) - points) * normals).sum(dim=1)
    B = implicit.basis(bulb.field, points)
    normal = B.T @ (weights[:, None] * B)
    damping = linear.DAMPING * normal.trace()
    x = torch.zeros_like(bulb.field.theta)
    for part in range(1, linear.PARTS + 1):
        right = B.T @ (weights * target * part / linear.PARTS) + damping * x
        x = torch.linalg.solve(normal + damping * torch.eye(len(x), dtype=x.dtype), right)
    rows = implicit.basis(bulb.field, torch.from_numpy(bulb.surface.V))
    np.testing.assert_allclose(model.speed(motion), (rows @ x).numpy(), rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(model.change(motion), x, rtol=1e-4, atol=1e-9)


def test_a_field_of_too_many_parameters_for_its_rows_has_the_same_preview(sphere, monkeypatch):
    """A sphere turned about its centre is the same, and dragged goes by n . t: both ways of solving must find it."""
    sphere.pick(EVERYTHING, grip=(0.0, 0.0, 0.0))
    motion = Motion(translation=(0.02, 0.01, -0.03), rotation=(0.1, 0.0, 0.0))
    with_rows = sphere.prepare().speed(motion)
    monkeypatch.setattr(linear, "DENSE_ENTRIES", 0)
    monkeypatch.setattr(sphere, "_models", {})
    without = sphere.prepare().speed(motion)
    np.testing.assert_allclose(without, with_rows, atol=1e-5)
    np.testing.assert_allclose(without, sphere.surface.N @ motion.translation, atol=1e-3)


def test_a_model_that_holds_the_volume_moves_it_to_second_order_only(bulb):
    bulb.pick(TIP)
    held = Settings(points=150, hold=("volume",))
    free, kept = (bulb.prepare(settings=settings) for settings in (bulb.settings, held))
    motion = Motion(along=0.02)
    quadrature = implicit.surface_quadrature(bulb.field, 40)
    points = quadrature.points
    rate = [
        quadrature.integrate(implicit.normal_displacement(bulb.field, points, model.change(motion)))
        for model in (free, kept)
    ]
    assert abs(rate[1]) < 0.05 * abs(rate[0])


def test_a_preview_ends_where_the_linear_model_does(bulb):
    bulb.pick(TIP)
    short = bulb.preview(Motion(translation=(0.005, 0.0, 0.0)))
    assert not short.capped
    long = bulb.preview(Motion(translation=(1.5, 0.0, 0.0)))
    assert long.capped
    assert long.fraction < 0.5
    assert "The preview ends at" in long.sentence()
    assert np.isfinite(long.V).all()


def test_what_the_field_cannot_make_is_said_before_and_comes_true(sphere):
    """A sphere makes no bump: the best is to move a little, and nearly all of the bump is missed."""
    sphere.pick(ball([0.5, 0.0, 0.0], 0.1, 0.1))
    missed = sphere.missed(Motion(along=0.05))
    assert missed.share > 0.7
    assert "cannot make that" in missed.sentence()
    assert missed.worst[0] > 0.4  # in the bump
    entry = sphere.drag(Motion(along=0.05))
    assert entry.numbers["missed"] == pytest.approx(missed.share, abs=0.05)
    assert not entry.done


def test_undo_and_redo_give_the_bits_back(bulb):
    start = bulb.field.theta.clone()
    moved(bulb)
    edited = bulb.field.theta.clone()
    assert not torch.equal(start, edited)
    assert bulb.undo().number == 1
    assert torch.equal(bulb.field.theta, start)
    assert bulb.history == ()
    bulb.redo()
    assert torch.equal(bulb.field.theta, edited)
    with pytest.raises(InputError, match="nothing to redo"):
        bulb.redo()
    bulb.undo()
    bulb.do(bulb.entries[0].handles[:1], settings=Settings(points=100), name="another")
    assert [entry.name for entry in bulb.entries] == ["another"]


@pytest.mark.parametrize(
    ("region", "role", "motion", "tool", "says"),
    [
        (TIP, "moves", Motion(), "geometric", "Nothing has moved"),
        (TIP, "held", Motion(translation=(0.1, 0.0, 0.0)), "geometric", "Nothing is to move"),
        (TIP, "moves", Motion(translation=(0.1, 0.0, 0.0)), "rigid", "needs a held region"),
        (TIP, "moves", Motion(translation=(0.1, 0.0, 0.0)), "semantic", "has none"),
        (TIP, "moves", Motion(translation=(0.1, 0.0, 0.0)), "hammer", "A tool is one of"),
        (EVERYTHING, "moves", Motion(translation=(50.0, 0.0, 0.0)), "geometric", "field is as it was"),
    ],
)
def test_a_refused_edit_leaves_all_as_it_was(sphere, region, role, motion, tool, says):
    before, surface = sphere.field, sphere.surface
    sphere.pick(region, role)
    with pytest.raises(InputError, match=says):
        sphere.drag(motion, tool)
    assert sphere.field is before
    assert sphere.surface is surface
    assert sphere.history == ()


def test_regions_off_the_surface_and_numbers_that_are_none_are_refused(sphere):
    with pytest.raises(InputError, match="No point of the surface"):
        sphere.pick(ball([5.0, 0.0, 0.0], 0.1))
    with pytest.raises(InputError, match='"moves" or is "held"'):
        sphere.pick(TIP, "floats")
    for numbers in ({"translation": (math.nan, 0, 0)}, {"factor": 0.0}, {"along": math.inf}, {"rotation": "x"}):
        with pytest.raises(ValueError, match="of a motion must be"):
            Motion(**numbers)
    with pytest.raises(ValueError, match="radius"):
        ball([0.0, 0.0, 0.0], -1.0)
    with pytest.raises(InputError, match="whole number"):
        Settings(points=3)


def test_an_edit_that_is_called_off_leaves_the_field(bulb):
    before = bulb.field
    bulb.pick(TIP)
    with pytest.raises(CalledOffError, match="called off"):
        bulb.drag(Motion(translation=(0.05, 0.0, 0.0)), progress=lambda *_: bulb.call_off())
    assert bulb.field is before
    assert moved(bulb).number == 1  # and the next one is not


def test_after_each_edit_the_session_is_on_disk(bulb, shape_file):
    moved(bulb)
    bulb.rename(1, "a tip | further out")
    kept = EditSession.load(bulb.folder)
    assert torch.equal(kept.field.theta, bulb.field.theta)
    assert kept.history == bulb.history
    bulb.undo()
    again = EditSession.open(str(shape_file), bulb.folder)
    assert torch.equal(again.field.theta, bulb.field.theta)
    assert len(again.entries) == 1
    again.redo()
    assert torch.equal(again.field.theta, kept.field.theta)
    with pytest.raises(InputError, match="holds a session of"):
        EditSession.open("spot", bulb.folder)
    (bulb.folder / "session.json").write_text("{")
    with pytest.raises(InputError, match="cut short"):
        EditSession.load(bulb.folder)


def test_an_edit_that_cannot_be_kept_on_disk_stands_and_says_so(bulb):
    shutil.rmtree(bulb.folder)
    bulb.folder.write_text("a file in its place")
    entry = moved(bulb)
    assert bulb.history == (entry,)
    assert any("is not on disk" in note for note in entry.notes)


def test_a_replay_and_the_script_give_the_same_field(bulb, tmp_path, monkeypatch):
    moved(bulb)
    bulb.drag(Motion(along=-0.01))
    assert torch.equal(bulb.replay().field.theta, bulb.field.theta)
    path = tmp_path / "edits.py"
    path.write_text(script(bulb))
    monkeypatch.chdir(tmp_path)
    again = runpy.run_path(str(path))["session"]
    assert torch.equal(again.field.theta, bulb.field.theta)
    assert [entry.name for entry in again.history] == [entry.name for entry in bulb.history]


def test_the_handles_and_the_case_of_an_edit_are_those_of_the_other_commands(bulb, tmp_path):
    entry = moved(bulb)
    export_handles(bulb, 1, tmp_path / "own.toml")
    units = bulb.field.units
    read = read_handles(tmp_path / "own.toml")
    assert read.coordinates == "user"
    assert tuple(handle.in_field(units.scale, units.offset) for handle in read.handles) == entry.handles
    assert read_handles(bulb.folder / "handles" / "001.toml").handles == entry.handles
    case = case_of(bulb, 1, vertices=300)
    assert type(case).from_json(case.to_json()) == case
    assert (case.handles, case.parameters["implicit"]["steps"]) == (entry.handles, entry.settings.steps)


@pytest.mark.nightly
def test_a_case_misses_what_the_edit_missed(bulb):
    moved(bulb)
    evidence = bulb.evidence()
    missed = np.sqrt(np.average(evidence.error**2, weights=evidence.before.areas))
    record = run_case(case_of(bulb, 1, vertices=1000))
    assert record.sides["implicit"].error_relative == pytest.approx(missed, abs=0.05)  # of points drawn otherwise


@pytest.mark.nightly
def test_handles_of_an_edit_run_unchanged_under_run_and_in_a_study(command, bulb, shape_file, tmp_path):
    moved(bulb)
    export_handles(bulb, 1, tmp_path / "own.toml")
    options = ["--operations", "geometric", "--quick", "-o", "run"]
    assert command("run", shape_file, "--handles", "own.toml", *options, cwd=tmp_path).returncode == 0
    _, _, rows = (bulb.folder / "handles" / "001.toml").read_text().partition("\n")
    (tmp_path / "study.toml").write_text(
        f'title = "One"\nshapes = ["{shape_file}"]\noperations = ["geometric"]\n'
        "[settings]\nvertices = 400\nresolution = 32\n[grid]\nimplicit.points = [100, 200]\n"
        f'[[charts]]\nx = "implicit.points"\ny = "error_relative"\n{rows}'
    )
    assert command("study", "study.toml", "-o", "study", "--no-meshes", cwd=tmp_path).returncode == 0


def test_a_held_volume_is_held_and_a_held_area_too(bulb):
    bulb.pick(TIP)
    entry = bulb.drag(Motion(along=0.03), settings=Settings(points=150, hold=("volume",)))
    before, after = entry.numbers["volume"]
    assert after == pytest.approx(before, rel=1e-4)
    assert entry.numbers["missed"] < 1.0


def test_regions_go_along_with_an_edit(bulb):
    bulb.pick(TIP)
    bulb.pick(half_space([0.0, -0.3, 0.0], [0.0, -1.0, 0.0]), "held")
    drag = np.array([0.04, 0.0, 0.01])
    held = bulb.regions[1]
    start = np.array(bulb.regions[0].region["center"])
    bulb.drag(Motion(translation=tuple(drag)))
    moving, still = bulb.regions
    np.testing.assert_allclose(np.array(moving.region["center"]) - start, drag, atol=0.02)
    assert still == held
    value = bulb.field.value(torch.tensor([moving.grip], dtype=torch.float64))
    assert abs(float(value)) < 1e-6  # the place by which it is held is on the surface


def test_a_late_verdict_amends_the_status(sphere):
    sphere.pick(ball([0.5, 0.0, 0.0], 0.1, 0.1))
    entry = sphere.drag(Motion(along=0.02))
    assert not entry.judged
    judged = sphere.judge()
    assert judged.judged
    assert "was not reached" in judged.status
    assert any("of the target is missed" in note for note in judged.notes)
    assert sphere.history == (judged,)


def test_regions_of_every_kind_can_be_dragged(bulb):
    for region in (
        brush([[0.3, 0.0, 0.25], [0.35, 0.05, 0.22]], 0.1),
        box([0.2, -0.2, 0.0], [0.6, 0.2, 0.4], 0.05),
        half_space([0.4, 0.0, 0.0], [1.0, 0.0, 0.0], 0.1),
    ):
        bulb.drop_regions()
        bulb.pick(region)
        entry = bulb.drag(Motion(translation=(0.01, 0.0, 0.0)))
        assert entry.numbers["missed"] < 0.9
        assert json.loads(json.dumps(entry.to_dict())) == entry.to_dict()


def test_a_function_of_the_users_own_is_run_only_where_it_is_named(tmp_path):
    (tmp_path / "own.py").write_text(
        "import implicit, implicit.shapes, torch\n"
        "class Own(torch.nn.Module):\n"
        "    def __init__(self):\n"
        "        super().__init__()\n"
        "        self.radius = torch.nn.Parameter(torch.tensor(0.5))\n"
        "    def forward(self, x):\n"
        "        return x.norm(dim=1) - self.radius\n"
        "def make():\n"
        "    return Own()\n"
        "def nothing():\n"
        "    return 3\n"
    )
    name = f"{tmp_path / 'own.py'}:make"
    session = EditSession.open(name, tmp_path / "kept", settings=Settings(points=50))
    session.pick(EVERYTHING)
    session.drag(Motion(along=0.1))
    assert float(session.field.theta[0]) == pytest.approx(0.6, abs=1e-3)
    with pytest.raises(InputError, match="No code is run because a file names it"):
        EditSession.load(tmp_path / "kept")
    again = EditSession.open(name, tmp_path / "kept")
    assert torch.equal(again.field.theta, session.field.theta)
    with pytest.raises(InputError, match=r"must return an implicit\.Field or a torch module"):
        EditSession.open(f"{tmp_path / 'own.py'}:nothing")


@pytest.mark.parametrize(
    ("shape", "says"),
    [
        ("sopt", "Did you mean spot"),
        ("there-is-none.obj", "There is no file"),
        ("nowhere.py:make", "there is no file"),
        ("", "must be a name"),
    ],
)
def test_what_is_no_shape_is_refused(shape, says):
    with pytest.raises(InputError, match=says):
        EditSession.open(shape)


def test_a_code_that_is_none_and_a_module_for_a_mesh_are_refused():
    with pytest.raises(InputError, match="codes 0 to"):
        EditSession.open("deepsdf-lamps", opening=Opening(code=100_000))
    with pytest.raises(InputError, match="Leave it out"):
        EditSession.open("spot", opening=Opening(module="own.py:make"))


def absurd(generator, count):
    """Regions and motions at random: some off the shape, some enormous, some that turn inside out."""
    for _ in range(count):
        center = generator.normal(size=3) * generator.choice([0.3, 3.0], p=[0.85, 0.15])
        radius = float(generator.choice([1e-6, 0.05, 0.2, 1.0, 30.0]))
        size = float(generator.choice([1e-9, 0.02, 0.3, 5.0, 1e6]))
        kind = generator.integers(4)
        if kind == 0:
            motion = Motion(along=size * float(generator.normal()))
        else:
            turn = tuple(generator.normal(size=3)) if kind > 1 else (0.0, 0.0, 0.0)
            factor = float(generator.choice([0.01, 0.5, 1.0, 3.0, 100.0])) if kind == 3 else 1.0
            motion = Motion(tuple(size * generator.normal(size=3)), turn, factor)
        yield ball(center, radius, float(generator.choice([0.0, 0.1, 2.0]))), motion


def drag_absurdly(session, count, seed):
    """Return the refusals of so many drags; each leaves the field whole, or as it was to the bit."""
    refused = []
    for region, motion in absurd(np.random.default_rng(seed), count):
        session.drop_regions()
        before = session.field
        try:
            session.pick(region)
            frame = session.preview(motion)
            assert np.isfinite(frame.V).all()
            session.drag(motion)
        except InputError as error:
            refused.append(str(error))
            assert session.field is before
        assert torch.isfinite(session.field.theta).all()
        assert isinstance(session._measured, Measured)
    return refused


def test_absurd_drags_are_refused_in_sentences(sphere):
    refused = drag_absurdly(sphere, 20, seed=1)
    assert refused
    assert all(sentence.rstrip().endswith((".", ")")) and sentence[0].isupper() for sentence in refused)


@pytest.mark.nightly
def test_two_hundred_absurd_drags_of_a_network_are_refused_in_sentences():
    session = EditSession.open("spot")
    refused = drag_absurdly(session, 200, seed=2)
    assert all(sentence.rstrip().endswith((".", ")")) and sentence[0].isupper() for sentence in refused)
