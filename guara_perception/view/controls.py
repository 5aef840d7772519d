"""Control panel of the browser view: timeline, visible parts, camera image, legend, status and cell texts."""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from guara_perception.arrays import Image
from guara_perception.images import for_screen, to_rgb
from guara_perception.terrain.drawing.style import UNKNOWN_COLOUR, rgb
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import MEANING, UNKNOWN_MASK, Hazard
from guara_perception.view.scene_drawing import REGION_COLOUR
from guara_perception.view.terrain_mesh import COLOURINGS, Scale, TerrainMesh

NO_CELL = "Click a cell to see what is known about it, and why it is or is not a safe foothold."
PICTURE_WIDTH_PX = 480
SHOWN = ("stripes", "footholds", "obstacles", "trail", "regions")
LIVE_STYLE, STALE_STYLE = "margin:0 1em", "margin:0 1em;color:#b00020;font-weight:bold"
# Regions are hidden at first, because they put many lines on the ground.
HIDDEN_AT_FIRST = ("regions",)
COLOURS_OF_A_BAR = 9
FREE = "a foot may be placed here"
REGION = 'tick "regions" to show them; the sole centre may be placed anywhere inside'
NEVER_OBSERVED = "unknown because never observed: never safe"
UNKNOWN = "no reliable height, for instance hidden or without a return: never safe"


class Controls:
    """Controls of the page, shared by all browsers.

    Attributes:
        colouring: viser control that selects how the terrain is coloured.
        extent: viser control that selects the grid shown, "map" or "footprint".
        follow: viser control that makes the camera follow the robot.
    """

    def __init__(self, gui: Any, *, go_to: Callable[[int], None], play: Callable[[], None], redraw: Callable[[], None]):
        """Create the controls.

        Args:
            gui: `gui` of viser, to which the controls are added.
            go_to: called when the slider moves, with the number of the selected moment.
            play: called when the play button is pressed.
            redraw: called when the colouring, the extent or a check box of `SHOWN` changes.
        """
        gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)
        gui.set_panel_label("Guará")
        self._live = gui.add_html("")
        self._status = gui.add_markdown("waiting for a scan")
        with gui.add_folder("walk"):
            self._slider = gui.add_slider("pause", min=0, max=1, step=1, initial_value=0, disabled=True)
            self._play = gui.add_button("play", disabled=True)
            self.follow = gui.add_checkbox("follow robot", initial_value=True)
        with gui.add_folder("ground"):
            self.colouring = gui.add_dropdown("colour", COLOURINGS, initial_value="hazard")
            self.extent = gui.add_dropdown("terrain", ("map", "footprint"), initial_value="map")
            self._legend = gui.add_html("")
        with gui.add_folder("overlays"):
            self._shown = {name: gui.add_checkbox(name, initial_value=name not in HIDDEN_AT_FIRST) for name in SHOWN}
        beside = gui.add_panel()
        with beside.add_tab("camera and cell"):
            self._picture = gui.add_image(np.full((2, 2, 3), 230, np.uint8), label="camera", visible=False)
            self._caption = gui.add_markdown("no camera image available")
            gui.add_divider()
            self._cell = gui.add_markdown(NO_CELL)
        beside.float(x=16, y=16, width=300)
        # Last image sent, so that the same image is not sent twice.
        self._sent: Image | None = None

        self._slider.on_update(lambda _: go_to(int(self._slider.value)))
        self._play.on_click(lambda _: play())
        for control in (self.colouring, self.extent, *self._shown.values()):
            control.on_update(lambda _: redraw())

    def shows(self, name: str) -> bool:
        """Test whether a part of `SHOWN` is visible."""
        return bool(self._shown[name].value)

    def has_stripes(self, available: bool) -> None:
        """Enable the check box "stripes" if there are stripes to show, otherwise disable it."""
        self._shown["stripes"].disabled = not available

    def timeline(self, count: int, number: int, *, playing: bool) -> None:
        """Show the number of moments, the current one, and the state of playback."""
        self._slider.max = max(count - 1, 1)
        self._slider.disabled = self._play.disabled = count < 2
        if int(self._slider.value) != number:
            self._slider.value = number
        self._play.label = "stop" if playing else "play"

    def live(self, text: str, is_stale: bool) -> None:
        """Show a line about the newest grid of a node, in red if the grid is stale; an empty text removes it."""
        content = f'<p style="{STALE_STYLE if is_stale else LIVE_STYLE}">{html.escape(text)}</p>' if text else ""
        if self._live.content != content:
            self._live.content = content

    def describe(self, status: str, legend: str) -> None:
        """Show the status and the legend of the grid."""
        self._status.content, self._legend.content = status, legend

    def picture(self, image: Image | None) -> None:
        """Show the camera image, (h, w) or (h, w, 3) BGR; None = not available."""
        self._picture.visible, self._caption.visible = image is not None, image is None
        if image is not None and image is not self._sent:
            self._picture.image = to_rgb(for_screen(image, PICTURE_WIDTH_PX))
        self._sent = image

    def cell(self, text: str | None) -> None:
        """Show the text of the clicked cell; None = no cell."""
        self._cell.content = NO_CELL if text is None else text


def legend_html(mesh: TerrainMesh) -> str:
    """Legend of a mesh as HTML: free cells and hazards, or a colour bar, then regions and cells that are not drawn."""
    rows = _scale_rows(mesh.scale) if mesh.scale is not None else _hazard_rows(mesh.legend)
    rows.append(_row("regions", REGION, f"border:2px solid rgb{REGION_COLOUR}".replace(" ", "")))
    rows.append(_row("not drawn", NEVER_OBSERVED, "border:1px dashed #888"))
    return f'<div style="font-size:0.75em;line-height:1.5;padding:0 1em">{"".join(rows)}</div>'


def _hazard_rows(legend: Sequence[tuple[str, str]]) -> list[str]:
    groups: tuple[list[str], list[str], list[str]] = ([], [], [])
    free, known, unknown = groups
    for name, colour in legend:
        style = f"background:{_css(colour)}"
        if name == "free":
            free.append(_row(name, FREE, style))
            continue
        flag = Hazard[name.upper().replace(" ", "_")]
        (unknown if int(flag) & int(UNKNOWN_MASK) else known).append(_row(name, MEANING[flag], style))
    for title, members in (("Known, not traversable", known), ("Unknown, never safe", unknown)):
        free += [f'<div style="opacity:0.7;margin-top:0.3em">{title}</div>', *members] if members else []
    return free


def _scale_rows(scale: Scale) -> list[str]:
    import matplotlib

    colours = matplotlib.colormaps[scale.colours](np.linspace(0, 1, COLOURS_OF_A_BAR))
    stops = ",".join(f"rgb({','.join(str(round(255 * value)) for value in colour[:3])})" for colour in colours)
    ends = f"<span>{scale.low_text}</span><span>{scale.high_text}</span>"
    return [
        f"<div><b>{scale.name}</b></div>",
        f'<div style="height:1em;border-radius:2px;background:linear-gradient(to right,{stops})"></div>',
        f'<div style="display:flex;justify-content:space-between">{ends}</div>',
        _row("unknown", UNKNOWN, f"background:{_css(UNKNOWN_COLOUR)}"),
    ]


def _row(name: str, meaning: str, style: str) -> str:
    box = f'<span style="display:inline-block;flex:none;width:1em;height:1em;margin-top:0.25em;{style}"></span>'
    return f'<div style="display:flex;gap:0.5em">{box}<span><b>{name}</b>: {meaning}</span></div>'


def _css(colour: str) -> str:
    return f"rgb({','.join(str(round(255 * value)) for value in rgb(colour))})"


def status_text(terrain: TerrainGrid) -> str:
    """Status of a grid in a few lines of Markdown."""
    record = terrain.record
    lines = [f"**step {terrain.step}**, {record.mode or 'unknown'} scan, {terrain.extent}"]
    known, free = float(np.isfinite(terrain.elevation).mean()), float((terrain.traversability > 0).mean())
    lines.append(f"known {known:.0%}, traversable {free:.0%}")
    if record.attitude_source:
        lines.append(f"attitude from {record.attitude_source}")
    if record.withdrawn:
        lines.append("**withdrawn**")
    elif record.provisional:
        lines.append("provisional: not yet confirmed that the robot stood still")
    lines += record.health.reasons if record.health else ()
    return "  \n".join(lines)


def cell_text(sentence: str) -> str:
    """Text of `TerrainGrid.explain` as Markdown, one line per part, with position and verdict in bold."""
    facts, _, verdict = sentence.partition(": ")
    where, _, rest = facts.partition(" is ")
    return f"**{where}**  \n{rest.replace(', ', '  ' + chr(10))}  \n**{verdict}**"
