"""The page of the editor: a session in the browser, by viser, on the loopback address.

The page itself only takes events and hands them to the worker; the session belongs to the worker's thread alone.

| event | work |
|---|---|
| click on the shape | a region is picked, and its linear model prepared |
| the gizmo moves | a frame of the linear model; of those that wait, only the newest |
| the gizmo is let go | the edit itself; afterwards pieces are counted on fine cells while nothing else is to do |
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import torch
import trimesh
import viser
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from compare.editor import drawing, regions
from compare.editor.controls import (
    BY_GIZMO,
    HINTS,
    NORMAL,
    NOTHING_BESIDE,
    SMOOTH,
    TOOL_OF,
    controls_of,
    history_text,
    numbers_text,
    options_of,
)
from compare.editor.exports import MESHES, case_of, export_field, export_handles, export_mesh, script
from compare.editor.mesh_side import Beside, beside
from compare.editor.motion import Motion
from compare.editor.session import EditSession
from compare.editor.tools import Settings, Tool
from compare.editor.worker import Worker
from compare.errors import InputError

HOST = "127.0.0.1"

# Seconds between two sentences while the hand moves.
SAYING = 0.2


class EditorPage:
    """A session on a page.

    Args:
        session: What is edited.
        host: Address to listen on; only the loopback address is this machine's alone.
        port: Port to listen on; another is taken where it is in use.

    Attributes:
        session: What is edited.
        server: Of viser.
        worker: That computes.
        frames: Number of frames of drags that were shown.
    """

    def __init__(self, session: EditSession, *, host: str = HOST, port: int = 8080) -> None:
        self.session = session
        self.frames = 0
        self._said = 0.0
        self._start = session.measures()
        self._corner: Float[ndarray, " 3"] | None = None  # the first of two clicks
        self._stroke: list[Float[ndarray, " 3"]] = []
        self._shown: tuple[Float[ndarray, "n 3"], ndarray] | None = None
        self._beside: Beside | None = None
        self._drawn: list[str] = []
        self._held_back = False  # while the page itself sets the gizmo
        self.worker = Worker(self._say_error)
        with redirect_stdout(StringIO()):  # viser prints a table of its own, also where it is not verbose
            self.server = viser.ViserServer(
                host=host, port=port, label=f"Edit {Path(session.source.shape).stem}", verbose=False
            )
        self._set_theme(dark=False)
        self.server.gui.main_panel.dock_right()
        self._set_camera()
        self.controls = controls_of(self.server.gui, session)
        self._shape = self._add_shape()
        self._gizmo = self.server.scene.add_transform_controls(
            "/gizmo", scale=0.14 * session.field.size, depth_test=False, visible=False
        )
        self._gizmo.on_update(self._on_gizmo)
        self._connect()
        self._refresh()

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def stop(self) -> None:
        """End the server and the worker."""
        self.session.call_off()
        self.worker.stop()
        with redirect_stdout(StringIO()):
            self.server.stop()

    # What the page is told

    def say(self, sentence: str) -> None:
        """Show a sentence at the top of the controls."""
        self.controls.status.content = sentence

    def _say_error(self, error: Exception) -> None:
        self._idle_controls()
        if isinstance(error, InputError):
            self.say(f"**Not done.** {error}")
        else:
            self.say(
                f"**Not done.** The page met an error of its own ({type(error).__name__}: {error}); nothing is lost."
            )

    def _idle_controls(self) -> None:
        self.controls.progress.visible = self.controls.cancel.visible = False

    # Events; each only hands work on

    def _connect(self) -> None:
        c = self.controls
        c.pick.on_update(lambda _: self._new_pick())
        c.forget.on_click(lambda _: self.worker.do(self._forget))
        c.tool.on_update(lambda _: self._new_tool())
        c.apply.on_click(lambda _: self.worker.do(self._apply))
        c.cancel.on_click(lambda _: self.session.call_off())
        c.undo.on_click(lambda _: self.worker.do(self._undo))
        c.redo.on_click(lambda _: self.worker.do(self._redo))
        c.view.on_update(lambda _: self.worker.do(self._recolour))
        c.before.on_update(lambda _: self.worker.show(self._morph))
        c.beside.on_update(lambda _: self.worker.do(self._set_beside))
        c.which.on_update(lambda _: self._name_of_chosen())
        c.rename.on_click(lambda _: self.worker.do(self._rename))
        c.replay.on_click(lambda _: self.worker.do(self._replay))
        c.distance.on_update(lambda _: self.worker.show(lambda: self._frame(Motion(along=c.distance.value))))
        for control in (c.volume, c.area, c.points, c.steps):
            control.on_update(lambda _: self.worker.do(self._prepare))
        c.export.on_click(lambda event: self.worker.do(lambda: self._export(event.client)))
        c.dark.on_update(lambda _: self._set_theme(dark=c.dark.value))

    def _new_pick(self) -> None:
        self._corner = None
        how = self.controls.pick.value
        self.controls.hint.content = HINTS[how]
        # A shape that can be dragged over takes the pointer from the parts of the gizmo that lie within it.
        self._shape.remove_drag_callback("all")
        if how == "brush":
            self._shape.on_drag("left", modifier="shift")(self._on_brush)

    def _new_tool(self) -> None:
        c = self.controls
        by_gizmo = c.tool.value in BY_GIZMO
        c.apply.visible = not by_gizmo
        c.factor.visible = by_gizmo
        c.distance.visible = c.tool.value == NORMAL
        self.worker.do(self._prepare)

    async def _on_gizmo(self, event: viser.TransformControlsEvent) -> None:
        if self._held_back or event.client is None:
            return
        motion = self._motion()
        if motion is None:
            return
        if event.phase == "end":
            self.worker.do(lambda: self._edit(motion))
        else:
            self.worker.show(lambda: self._frame(motion))

    def _on_click(self, event: viser.SceneClickEvent) -> None:
        origin, direction = np.asarray(event.ray_origin), np.asarray(event.ray_direction)
        self.worker.do(lambda: self._clicked(origin, direction))

    async def _on_brush(self, event: viser.SceneNodeDragEvent[Any]) -> None:
        camera = event.client.camera
        direction = drawing.sight(camera.wxyz, camera.fov, camera.aspect, event.end_screen_pos)
        place = drawing.under_ray(self.session.surface.V, self.session.surface.F, camera.position, direction)
        if event.phase == "start":
            self._stroke = []
        if place is not None:
            self._stroke.append(place)
        if event.phase == "end" and self._stroke:
            stroke = np.array(self._stroke)
            self.worker.do(lambda: self._brushed(stroke))

    # Work: picking

    def _clicked(self, origin: Float[ndarray, " 3"], direction: Float[ndarray, " 3"]) -> None:
        surface = self.session.surface
        place = drawing.under_ray(surface.V, surface.F, origin, direction)
        if place is None:
            raise InputError("There is no surface there. Click the shape.")
        c = self.controls
        radius, falloff, how = c.radius.value, c.falloff.value, c.pick.value
        if how == "brush":
            self._brushed(place[None])
            return
        if how == "ball":
            region = regions.ball(place, radius, falloff)
        elif how == "half-space":
            normal = surface.N[((surface.V - place) ** 2).sum(axis=1).argmin()]
            region = regions.half_space(place - radius * normal, normal, falloff)
        elif self._corner is None:
            self._corner = place
            self.say("Now click the other end.")
            return
        else:
            first, self._corner = self._corner, None
            if how == "box":
                lower, upper = np.minimum(first, place) - radius, np.maximum(first, place) + radius
                region = regions.box(lower, upper, falloff)
            else:
                region = regions.beyond_stroke(first, place, direction, falloff)
        self._pick(region, place if how != "beyond a stroke" else None)

    def _brushed(self, stroke: Float[ndarray, "m 3"]) -> None:
        c, kept = self.controls, self.session.regions
        # A click goes on with the brush before it.
        if len(stroke) == 1 and kept and kept[-1].region["kind"] == "points" and kept[-1].role == c.role.value:
            stroke = np.concatenate([np.asarray(kept.pop().region["centers"]), stroke])
        region = regions.brush(stroke, c.radius.value, c.falloff.value)
        self._pick(region, stroke[len(stroke) // 2])

    def _pick(self, region: dict[str, Any], grip: Float[ndarray, " 3"] | None) -> None:
        self.session.pick(region, self.controls.role.value, None if grip is None else grip.tolist())
        self._draw_regions()
        self._prepare()

    def _prepare(self) -> None:
        """Prepare the linear model of what is picked, and say what the field cannot do."""
        moving = [picked for picked in self.session.regions if picked.role == "moves"]
        self._place_gizmo()
        if not moving:
            return
        c = self.controls
        if c.tool.value == SMOOTH:
            self.say("Apply smooths the regions that move; without any, all of the surface.")
            return
        model = self.session.prepare(self._tool(), self._settings())
        missed = model.missed(Motion(along=0.02 * self.session.field.size))
        hand = "Drag the gizmo." if c.tool.value in BY_GIZMO else "Set how far, then Apply."
        self.say(f"{hand} Out of the surface here: {missed.sentence()}")
        if c.view.value == "cannot be made":
            self._show_colours(missed.error, "Predicted minus wanted, of the largest wanted")

    def _forget(self) -> None:
        self.session.drop_regions()
        self._draw_regions()
        self._place_gizmo()
        self.say("Pick a region on the shape.")

    # Work: frames and edits

    def _tool(self) -> Tool:
        return TOOL_OF[self.controls.tool.value]

    def _settings(self) -> Settings:
        c = self.controls
        hold = tuple(name for name, on in (("volume", c.volume.value), ("area", c.area.value)) if on)
        steps = None if c.steps.value == "auto" else int(c.steps.value)
        return replace(self.session.settings, hold=hold, points=int(c.points.value), steps=steps)

    def _motion(self) -> Motion | None:
        moving = [picked for picked in self.session.regions if picked.role == "moves"]
        if not moving:
            return None
        w, x, y, z = self._gizmo.wxyz
        shift = np.asarray(self._gizmo.position) - np.asarray(moving[0].grip)
        turn = Rotation.from_quat([x, y, z, w]).as_rotvec()
        return Motion(tuple(shift), tuple(turn), float(self.controls.factor.value))

    def _frame(self, motion: Motion) -> None:
        """Show a frame of a drag."""
        if not any(picked.role == "moves" for picked in self.session.regions):
            return
        frame = self.session.preview(motion, self._tool(), self._settings())
        self._show_shape()
        self._shape.vertices = frame.V.astype(np.float32)
        self.frames += 1
        if monotonic() - self._said > SAYING:  # or drawing the words would hold up the shape
            self._said = monotonic()
            self.say(frame.sentence())

    def _apply(self) -> None:
        if self.controls.tool.value == SMOOTH:
            self._edit(Motion())
        else:
            self._edit(Motion(along=float(self.controls.distance.value)))

    def _edit(self, motion: Motion) -> None:
        c, session = self.controls, self.session
        if motion.at_rest and self._tool() != "smooth":
            return  # the gizmo was touched, and not moved
        c.progress.value, c.progress.visible, c.cancel.visible = 0.0, True, True

        def tell(step: int, steps: int, row: dict[str, Any]) -> None:
            c.progress.value = 100.0 * step / max(steps, 1)

        try:
            entry = session.drag(motion, self._tool(), self._settings(), progress=tell)
        finally:
            self._idle_controls()
            self._beside = None
            self._refresh()
        c.factor.value = 1.0
        self._say_entry(entry)
        self.worker.when_idle(self._judge)
        if c.beside.value != NOTHING_BESIDE:
            self.worker.do(self._set_beside)

    def _judge(self) -> None:
        if self.session.position and not self.session.entries[self.session.position - 1].judged:
            entry = self.session.judge()
            self._say_entry(entry)
            self._show_history()

    def _say_entry(self, entry: Any) -> None:
        missed = entry.numbers.get("missed")
        told = any("is missed" in note for note in entry.notes)
        share = "" if missed is None or told else f" {100 * missed:.2g} % was missed."
        fine = "" if entry.judged else " Pieces are being counted on finer cells."
        self.say(" ".join([f"**{entry.name}**, {entry.seconds:.1f} s: {entry.status}{share}{fine}", *entry.notes]))

    def _undo(self) -> None:
        entry = self.session.undo()
        self._after_jump(f"Undone: {entry.name}.")

    def _redo(self) -> None:
        entry = self.session.redo()
        self._after_jump(f"Done again: {entry.name}.")

    def _after_jump(self, sentence: str) -> None:
        self.session.drop_regions()
        self._beside = None
        self._refresh()
        self.say(sentence)

    def _replay(self) -> None:
        self.controls.progress.visible = True
        done = 0

        def tell(step: int, steps: int, row: dict[str, Any]) -> None:
            self.controls.progress.value = 100.0 * (done + step / max(steps, 1)) / max(len(self.session.history), 1)

        try:
            again = self.session.replay(progress=tell)
        finally:
            self._idle_controls()
        same = bool(torch.equal(again.field.theta, self.session.field.theta))
        self.say(
            f"All {self.session.position} edits were done again from the start: "
            f"{'the same field, to the bit' if same else 'another field; its numbers differ'}."
        )

    def _rename(self) -> None:
        c = self.controls
        if c.which.value != "none":
            self.session.rename(int(c.which.value.split(":")[0]), c.name.value)
            self._show_history()

    def _name_of_chosen(self) -> None:
        c = self.controls
        if c.which.value != "none":
            c.name.value = c.which.value.split(": ", 1)[1]

    # Work: what is drawn

    def _set_theme(self, *, dark: bool) -> None:
        self.server.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)

    def _set_camera(self) -> None:
        self.server.scene.set_up_direction("+y")
        self.server.scene.configure_default_lights(cast_shadow=False)  # which would be drawn anew in every frame
        V = self.session.surface.V
        middle, size = (V.min(axis=0) + V.max(axis=0)) / 2, float(np.linalg.norm(V.max(axis=0) - V.min(axis=0)))
        self.server.initial_camera.position = tuple(middle + size * np.array([-0.46, 0.27, -0.62]))
        self.server.initial_camera.look_at = tuple(middle)

    def _add_shape(self) -> viser.MeshHandle:
        surface = self.session.surface
        shape = self.server.scene.add_mesh_simple(
            "/shape",
            surface.V.astype(np.float32),
            surface.F.astype(np.uint32),
            color=drawing.SHAPE,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        # A click on the scene, for a node that can be clicked is outlined, which hides what is picked on it.
        self.server.scene.on_click()(self._on_click)
        return shape

    def _refresh(self) -> None:
        """Draw the field as it is, with all that belongs to it."""
        surface = self.session.surface
        with self.server.atomic():
            self._shape.vertices = surface.V.astype(np.float32)
            self._shape.faces = surface.F.astype(np.uint32)
            self._show_shape()
            self._draw_regions()
            self._draw_beside()
        self._place_gizmo()
        c = self.controls
        c.numbers.content = numbers_text(self.session.measures(), self._start)
        c.before.disabled = self.session.evidence() is None
        c.before.value = 1.0
        self._show_history()
        self._recolour()

    def _show_history(self) -> None:
        c, session = self.controls, self.session
        c.history.content = history_text(session)
        c.undo.disabled, c.redo.disabled = session.position == 0, session.position == len(session.entries)
        for control in (c.which, c.name, c.rename, c.replay):
            control.visible = bool(session.entries)
        chosen, options = c.which.value, options_of(session.entries)
        c.which.options = options
        c.which.value = chosen if chosen in options else options[-1]
        self._name_of_chosen()

    def _place_gizmo(self) -> None:
        moving = [picked for picked in self.session.regions if picked.role == "moves"]
        self._held_back = True
        try:
            self._gizmo.visible = bool(moving) and self.controls.tool.value in BY_GIZMO
            if moving:
                self._gizmo.position = moving[0].grip
                self._gizmo.wxyz = (1.0, 0.0, 0.0, 0.0)
        finally:
            self._held_back = False

    def _draw_regions(self) -> None:
        scene, surface, size = self.server.scene, self.session.surface, self.session.field.size
        for name in self._drawn:
            scene.remove_by_name(name)
        self._drawn = []
        points = torch.from_numpy(surface.V)
        for k, picked in enumerate(self.session.regions):
            weights = regions.held(picked.region).build().weights(points).numpy()
            colour = drawing.HELD if picked.role == "held" else drawing.REGIONS[k % len(drawing.REGIONS)]
            places, faded = drawing.dots(surface, weights, colour, size)
            if len(places):
                name = f"/regions/{k}"
                scene.add_point_cloud(
                    name,
                    places.astype(np.float32),
                    faded,
                    point_size=0.006 * size,
                    point_shape="circle",
                    precision="float32",
                )
                self._drawn.append(name)

    def _show_shape(self) -> None:
        """Show the shape without colours of numbers."""
        if self._shown is not None:
            self.server.scene.remove_by_name("/coloured")
            self._shown = None
            self.controls.scale.visible = False
        self._shape.visible = True

    def _recolour(self) -> None:
        """Show the colours that are chosen, where there are some."""
        view, evidence = self.controls.view.value, self.session.evidence()
        if view == "achieved minus wanted" and evidence is not None and np.isfinite(evidence.error).any():
            self._show_colours(evidence.error, "Achieved minus wanted, of the largest wanted", evidence.carried())
        elif view == "cannot be made":
            self._prepare()
        else:
            self._show_shape()

    def _show_colours(self, values: Float[ndarray, " n"], title: str, V: Float[ndarray, "n 3"] | None = None) -> None:
        """Show numbers at the vertices as colours, with their scale.

        Args:
            values: Of the vertices drawn now, or of those drawn before the last edit.
            title: Of the scale.
            V: Where the latter are; None takes the former.
        """
        evidence = self.session.evidence()
        before = self.session.surface if V is None or evidence is None else evidence.before
        places = before.V if V is None else V
        largest = drawing.shown_range(values)
        painted = drawing.colours(values, largest).astype(np.uint8)
        mesh = trimesh.Trimesh(places, before.F, vertex_colors=painted, process=False)
        _ = mesh.vertex_normals  # which are sent once they are known, so that the shape is not drawn in facets
        self.server.scene.add_mesh_trimesh("/coloured", mesh, cast_shadow=False, receive_shadow=False)
        self._shape.visible = False
        self._shown = (places, before.F)
        self.controls.scale.content = drawing.scale_of_colours(title, largest)
        self.controls.scale.visible = True

    def _morph(self) -> None:
        """Show the surface between before and after the last edit."""
        evidence, share = self.session.evidence(), float(self.controls.before.value)
        if evidence is None:
            return
        self._show_shape()
        if share >= 1:
            self._shape.vertices = self.session.surface.V.astype(np.float32)
            self._shape.faces = self.session.surface.F.astype(np.uint32)
            self._recolour()
            return
        V = evidence.before.V + share * (evidence.carried() - evidence.before.V)
        with self.server.atomic():
            self._shape.vertices = V.astype(np.float32)
            self._shape.faces = evidence.before.F.astype(np.uint32)

    def _set_beside(self) -> None:
        """Show what a mesh method makes of the handles of the last edit, and the energies of both."""
        method, evidence = self.controls.beside.value, self.session.evidence()
        self._beside = None
        if method != NOTHING_BESIDE:
            if evidence is None:
                raise InputError("There is no edit that was made just now to set a mesh beside. Drag something first.")
            entry = self.session.entries[self.session.position - 1]
            if entry.tool == "smooth":
                raise InputError("Smoothing has no handles to give to a mesh. Drag something.")
            before = self.session.field_before(entry.number)
            self.say(f"{method} on the mesh ...")
            self._beside = beside(before, evidence.edit, entry.handles, method, rest_stays=entry.tool == "geometric")
            self._say_entry(entry)
        self._draw_beside()

    def _draw_beside(self) -> None:
        scene, found = self.server.scene, self._beside
        for name in ("/beside", "/beside label", "/label"):
            scene.remove_by_name(name)
        self.controls.energies.content = ""
        if found is None:
            return
        low, high = found.V.min(axis=0), found.V.max(axis=0)
        away = np.array([1.5 * (high[0] - low[0]), 0.0, 0.0])
        scene.add_mesh_simple(
            "/beside",
            (found.moved + away).astype(np.float32),
            found.F.astype(np.uint32),
            color=(215, 190, 150),
            side="double",
        )
        top = np.array([(low[0] + high[0]) / 2, high[1] + 0.1 * (high[1] - low[1]), (low[2] + high[2]) / 2])
        scene.add_label("/label", "field", position=tuple(top), anchor="bottom-center")
        scene.add_label("/beside label", f"mesh, {found.method}", position=tuple(top + away), anchor="bottom-center")
        rows = [f"| energy | field | mesh, {found.method} |", "|---|---|---|"]
        rows += [f"| {name} | {field:.3g} | {mesh:.3g} |" for name, (mesh, field) in found.energies.items()]
        self.controls.energies.content = "\n".join([*rows, "", f"{found.status} {found.seconds:.2f} s."])

    # Work: files

    def _export(self, client: viser.ClientHandle | None) -> None:
        kind = self.controls.file_type.value
        name, content = exported(self.session, kind)
        if self.session.folder is not None:
            kept = self.session.folder / "exports" / name
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_bytes(content)
            self.say(f"Written to {kept}.")
        else:
            self.say(f"{name}: {len(content):,} bytes.")
        if client is not None:
            client.send_file_download(name, content, save_immediately=True)


def exported(session: EditSession, kind: str) -> tuple[str, bytes]:
    """Return the name and content of what is exported: a mesh by its ending, a field, a script, handles or a case.

    Raises:
        InputError: It cannot be.
    """
    stem = f"{Path(session.source.shape.replace(':', '-')).stem}-{session.position}"
    last = session.position
    if kind == "script":
        return f"{stem}.py", script(session, f"{stem}.py").encode()
    if kind == "case":
        _require_edit(last)
        return f"{stem}.json", json.dumps(case_of(session, last).to_dict(), indent=1).encode()
    writers: dict[str, tuple[str, Callable[[Path], None]]] = {
        "field": (".safetensors", lambda path: export_field(session, path)),
        "handles": (".toml", lambda path: export_handles(session, last, path)),
        **{ending: (ending, lambda path: export_mesh(session, path)) for ending in MESHES},
    }
    if kind == "handles":
        _require_edit(last)
    ending, write = writers[kind]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{stem}{ending}"
        write(path)
        return path.name, path.read_bytes()


def _require_edit(last: int) -> None:
    if last == 0:
        raise InputError("There is no edit yet. Drag something first.")
