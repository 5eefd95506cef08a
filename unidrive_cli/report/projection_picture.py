"""The virtual projection error as a picture: from above, and against distance.

matplotlib comes with nuscenes-devkit.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from unidrive_cli.measure.projection import CELL_M, CELLS, ProjectionReport, Spread, distance_bands
from unidrive_cli.rig.model import Rig

_CAR_M = (4.1, 1.7)
_REAR_AXLE_TO_CENTRE_M = 1.3
_CONE_M = 9.0
_PERCENTILES = (2, 98)
_DPI = 130
_SURFACE = "#f1f1ee"


def draw_projection(report: ProjectionReport, path: Path) -> None:
    """Draws a report as a PNG of some 1,700 by 800 pixels.

    Raises:
        OSError: the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.2, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    above, along = figure.subplots(1, 2, width_ratios=(1.05, 1))
    choices, mean = report.choices, report.overall.pairs.mean
    figure.suptitle(
        f"Virtual projection error of {report.rig.name}  (depth limit {choices.depth_limit_m:g} m, "
        f"{report.overall.pairs.count:,} pairs, mean {'-' if mean is None else f'{mean:.4f}'} m rad)",
        fontsize=12.5,
    )
    _draw_from_above(figure, above, report)
    _draw_along_distance(along, report)
    figure.savefig(path, dpi=_DPI, format="png", metadata={"Software": None})


def _draw_from_above(figure: Any, axes: Any, report: ProjectionReport) -> None:
    from matplotlib.colors import LogNorm

    view, reach = report.top_view, CELLS * CELL_M / 2
    filled = view.count > 0
    mean = np.full(view.sum.shape, np.nan)
    np.divide(view.sum, view.count, out=mean, where=filled)
    positive = mean[filled & (mean > 0)]
    low, high = np.percentile(positive, _PERCENTILES) if len(positive) else (1e-3, 1.0)
    norm = LogNorm(max(low, high / 1000), max(high, 1.01 * low))
    image = axes.imshow(mean, origin="lower", extent=(-reach, reach, -reach, reach), cmap="viridis", norm=norm)
    _draw_car(axes, report.rig)
    axes.set_facecolor(_SURFACE)
    axes.set_xlim(reach, -reach)
    axes.set_ylim(-reach, reach)
    axes.grid(color="white", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel("y, left of the car (m)")
    axes.set_ylabel("x, ahead of the car (m)")
    beyond = f", {view.beyond:,} beyond" if view.beyond else ""
    axes.set_title(f"mean error of the blend by the corner's place (squares of {CELL_M:g} m{beyond})", fontsize=10)
    figure.colorbar(image, ax=axes, label="metre-radians", shrink=0.86, pad=0.02, extend="both")


def _draw_car(axes: Any, rig: Rig) -> None:
    """The car's outline, and where each virtual camera stands and how wide it sees."""
    length, width = _CAR_M
    back = _REAR_AXLE_TO_CENTRE_M - length / 2
    outline = np.array([[back, 1], [back + length, 1], [back + length, -1], [back, -1], [back, 1]])
    axes.plot(outline[:, 1] * width / 2, outline[:, 0], color="#222222", linewidth=1.4)
    for camera in rig.cameras:
        x, y = camera.centre_ego[:2]
        middle, half = (math.radians(angle) for angle in (camera.yaw_pitch_roll_deg[0], camera.pinhole.hfov_deg / 2))
        for angle in (middle - half, middle + half):
            ends = np.array([[x, y], [x + _CONE_M * math.cos(angle), y + _CONE_M * math.sin(angle)]])
            axes.plot(ends[:, 1], ends[:, 0], color="#d1495b", linewidth=0.9)


def _draw_along_distance(axes: Any, report: ProjectionReport) -> None:
    bands = distance_bands()
    places = np.arange(len(bands))
    found = report.by_distance
    spreads: tuple[tuple[str, str, list[Spread]], ...] = (
        ("pairs", "#30638e", [errors.pairs for errors in found]),
        ("blended", "#d1495b", [errors.blended for errors in found if errors.blended is not None]),
    )
    drawn = []
    for name, colour, of_band in spreads:
        for label, style, values in (
            ("90th percentile", "--", [spread.p90 for spread in of_band]),
            ("median", "-", [spread.median for spread in of_band]),
        ):
            line = np.array([np.nan if value is None else value for value in values])
            drawn.append(line)
            axes.plot(places, line, style, marker="o", markersize=4, color=colour, label=f"{name}, {label}")
    values = np.concatenate(drawn)
    if (values[np.isfinite(values)] > 0).all() and np.isfinite(values).any():
        axes.set_yscale("log")
    axes.set_xticks(
        places,
        [
            f"{low} to {high}\n{errors.pairs.count:,}" if high else f"{low} +\n{errors.pairs.count:,}"
            for (low, high), errors in zip(bands, found, strict=True)
        ],
    )
    axes.set_xlabel("distance from the virtual camera (m), and pairs there")
    axes.set_ylabel("error (metre-radians)")
    axes.tick_params(labelsize=9)
    axes.tick_params(which="minor", labelsize=7)
    axes.grid(which="major", color="#dddddd", linewidth=0.8)
    axes.grid(which="minor", color="#eeeeee", linewidth=0.5)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_title("error against distance", fontsize=10)
    axes.legend(frameon=False, fontsize=9)
