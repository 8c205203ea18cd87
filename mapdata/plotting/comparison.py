"""The figure that compares planners: what their paths cost, against what they expand."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mapdata.arrays import Floats
from mapdata.checks import check_choice
from mapdata.plotting.label_places import Box, Drawing
from mapdata.plotting.plot import new_axes

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

_OWN_COLOURS = ("#CC79A7", "#009E73", "#D55E00", "#E69F00", "#56B4E9", "#0072B2")
"""Colours of one's own planners: those of `PALETTE`, and that of predicted paths first."""

_OTHER_COLOUR = "0.5"

_MEMBER = re.compile(r"(.+) \((\d+(?:\.\d+)?)\)")
"""The name of a planner with a parameter, such as "weighted A* (1.5)"."""

_MARK_RADIUS = 4.0
"""Of a mark, in points."""

_SAME_PLACE = 2.5
"""Points between the middles of marks that look like one, and share a label."""


def plot_planners(
    table: pd.DataFrame,
    axes: Axes | None = None,
    *,
    subset: str = "hard",
    own: Sequence[str] = (),
) -> Axes:
    """Draw the cost ratio of each planner against its expansion ratio; left and low is good.

    Bars are 95 % intervals. A label names each mark, and marks at the same place share one. A line
    joins planners that differ in a parameter, such as "weighted A* (1.1)" and "weighted A* (2)"; of
    them the first label has the name, and the others have the parameter alone, except for ``own``.

    Planners that have no place are named below the axis: those that solve no problem, and those
    whose expansions are 0 or unknown.

    Args:
        table: what `evaluate` returns.
        axes: where to draw; default a new figure.
        subset: "hard" or "all".
        own: names of planners that are drawn in colours of their own; the others are grey.

    Raises:
        ValueError: there is no such subset, or no planner of a name in ``own``.
    """
    check_choice("subset", subset, ("hard", "all"))
    axes = axes or new_axes(size=(7, 5.5))[0]
    rows = table[table["subset"] == subset].set_index("planner")
    for name in own:
        check_choice("own", name, list(rows.index))
    colours = dict.fromkeys(rows.index, _OTHER_COLOUR)
    colours |= {name: _OWN_COLOURS[k % len(_OWN_COLOURS)] for k, name in enumerate(own)}
    places = rows[["expansion_ratio", "cost_ratio"]].astype(np.float64)
    has_place = places.notna().all(axis=1) & (places["expansion_ratio"] > 0)
    shown = rows[has_place]
    own_last = sorted(shown.index, key=lambda name: name in own)  # above the other marks
    for name in own_last:
        _draw_mark(axes, shown.loc[name], name, colours[name], is_own=name in own)
    families = _families(shown.index)
    for members in families.values():
        line = shown.loc[members]
        (colour, *_) = (colours[name] for name in members)
        axes.plot(line["expansion_ratio"], line["cost_ratio"], color=colour, lw=1.2, label="_")
    missing = "" if shown.empty else _missing_text(rows[~has_place])
    axes.set(
        xlabel="expansions / those of A* (mean); left is better" + missing,
        ylabel="cost / optimal cost (mean of the solved); low is better",
        title=f"{subset} problems: {rows['n'].max():,}",
    )
    axes.margins(0.12, 0.12)
    bottom, top = axes.get_ylim()
    axes.set_ylim(bottom - 0.1 * (top - bottom), top)  # room for labels below the optimal planners
    _scale_axes(axes, shown["expansion_ratio"].to_numpy())
    axes.grid(alpha=0.3)
    if not shown.empty:
        _label_marks(axes, shown, families, own)
    return axes


def _draw_mark(axes: Axes, row: pd.Series[Any], name: str, colour: str, *, is_own: bool) -> None:
    """Draw the mark of a planner, filled for one's own, and its two intervals."""
    x, y = row["expansion_ratio"], row["cost_ratio"]
    order = 3 if is_own else 2
    for interval in (
        axes.hlines(y, row["expansion_ratio_low"], row["expansion_ratio_high"], colour),
        axes.vlines(x, row["cost_ratio_low"], row["cost_ratio_high"], colour),
    ):
        interval.set(linewidth=1, alpha=0.6, zorder=order)
    axes.plot(
        x,
        y,
        "o",
        color=colour,
        markerfacecolor=colour if is_own else "none",
        markeredgewidth=1.6,
        markersize=2 * _MARK_RADIUS - 1.6,
        label=name,
        zorder=order + 0.5,
    )


def _families(names: Iterable[str]) -> dict[str, list[str]]:
    """Return the names of planners that differ in a parameter, by what they share, in its order."""
    parameters: dict[str, dict[str, float]] = {}
    for name in names:
        if match := _MEMBER.fullmatch(name):
            parameters.setdefault(match[1], {})[name] = float(match[2])
    return {
        shared: sorted(members, key=lambda name: members[name])
        for shared, members in parameters.items()
        if len(members) > 1
    }


def _missing_text(rows: pd.DataFrame) -> str:
    """Return a line that names planners without a place in the figure; empty without any."""
    reasons = []
    for name, row in rows.iterrows():
        if not np.isfinite(row["cost_ratio"]):
            reasons.append(f"{name} (solved none)")
        else:
            reason = "no expansions" if row["expansion_ratio"] == 0 else "expansions unknown"
            reasons.append(f"{name} ({reason})")
    if not reasons:
        return ""
    return "\n" + textwrap.fill(f"not shown: {', '.join(reasons)}", 80)


def _scale_axes(axes: Axes, ratios: Floats) -> None:
    """Make the axis of expansions logarithmic, with few labels of ticks, as plain numbers."""
    from matplotlib.ticker import AutoLocator, LogLocator, NullLocator

    axes.set_xscale("log")
    axes.ticklabel_format(axis="y", useOffset=False)
    decades = np.log10(ratios.max() / ratios.min()) if len(ratios) else 0.0
    digits_up_to = {1.0: (1, 1.5, 2, 3, 5, 7), 2.0: (1, 2, 5), 3.0: (1, 3), np.inf: (1,)}
    if decades < 0.3:
        axes.xaxis.set_major_locator(AutoLocator())
    else:
        digits = next(digits for limit, digits in digits_up_to.items() if decades < limit)
        axes.xaxis.set_major_locator(LogLocator(subs=digits))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter("{x:g}")


def _label_marks(
    axes: Axes,
    shown: pd.DataFrame,
    families: dict[str, list[str]],
    own: Sequence[str],
) -> None:
    """Write the name of each planner beside its mark, so that no label covers another or a mark."""
    figure: Any = axes.figure  # matplotlib's type hints also allow None here
    figure.draw_without_rendering()  # makes the layout
    points_per_pixel = 72 / figure.dpi
    marks = shown[["expansion_ratio", "cost_ratio"]].to_numpy()
    places = axes.transData.transform(marks) * points_per_pixel
    drawing = Drawing(
        page=Box(*(axes.bbox.extents * points_per_pixel)),
        marks=places,
        radius=_MARK_RADIUS,
        lines=axes.transData.transform(_points_of_lines(axes, shown, families)) * points_per_pixel,
    )
    texts = {name: textwrap.fill(str(name), 30) for name in shown.index}
    for members in families.values():
        for name in members[1:]:
            if name not in own and (match := _MEMBER.fullmatch(name)):
                texts[name] = match[2]
    names = list(shown.index)
    groups = _groups(places, [name in own for name in names])
    words = ["\n".join(texts[names[k]] for k in group) for group in groups]
    weights = ["bold" if names[group[0]] in own else "normal" for group in groups]
    sizes = []
    for text, weight in zip(words, weights, strict=True):
        probe = figure.text(0, 0, text, fontsize="small", fontweight=weight)
        extent = probe.get_window_extent()
        probe.remove()
        sizes.append(points_per_pixel * np.array([extent.width, extent.height]))
    centres = [places[group].mean(axis=0) for group in groups]
    labels = drawing.place_labels(centres, sizes)
    for k, label in enumerate(labels):
        side = round((centres[k][0] - label.box.left) / sizes[k][0] - 0.5)
        leader: dict[str, Any] = {
            "arrowstyle": "-",
            "color": _OTHER_COLOUR,
            "linewidth": 0.6,
            "relpos": (label.box.nearest(centres[k]) - label.box[:2]) / sizes[k],
            "shrinkA": 0,
            "shrinkB": _MARK_RADIUS,
        }
        annotation = axes.annotate(
            words[k],
            marks[groups[k][0]],
            label.box[:2] - places[groups[k][0]],
            textcoords="offset points",
            ha="left",
            va="bottom",
            multialignment=("left", "center", "right")[int(np.sign(side)) + 1],
            arrowprops=leader if len(label.leader) else None,
            fontsize="small",
            fontweight=weights[k],
        )
        annotation.set_in_layout(False)  # The layout, for which labels were placed, stays.


def _points_of_lines(axes: Axes, shown: pd.DataFrame, families: dict[str, list[str]]) -> Floats:
    """Return points (n, 2) along the intervals and the lines of families, as data."""
    ends = []
    for _, row in shown.iterrows():
        x, y = row["expansion_ratio"], row["cost_ratio"]
        ends.append([(row["expansion_ratio_low"], y), (row["expansion_ratio_high"], y)])
        ends.append([(x, row["cost_ratio_low"]), (x, row["cost_ratio_high"])])
    for members in families.values():
        line = shown.loc[members, ["expansion_ratio", "cost_ratio"]].to_numpy()
        ends += np.stack([line[:-1], line[1:]], axis=1).tolist()
    # An interval may reach to 0, which has no place on a logarithmic axis. Each of the (n, 2, 2)
    # segments has two points (x, y).
    segments = np.clip(ends, *np.transpose([axes.get_xlim(), axes.get_ylim()]))
    shares = np.linspace(0, 1, 30)[:, None, None]
    first, last = segments[:, 0], segments[:, 1]
    points: Floats = first + shares * (last - first)
    return points.reshape(-1, 2)


def _groups(places: Floats, is_own: Sequence[bool]) -> list[list[int]]:
    """Return the numbers of marks that share a label, in the order in which labels are placed.

    Marks at one place share one, but each of one's own has a label of its own. These come first,
    and then marks with many others around them, which leave little choice.

    Args:
        places: (n, 2) of the marks, in points.
        is_own: whether each is one's own.
    """
    groups: list[list[int]] = []
    for k, place in enumerate(places):
        for group in groups:
            is_same_place = np.hypot(*(places[group[0]] - place)) < _SAME_PLACE
            if is_same_place and not is_own[k] and not is_own[group[0]]:
                group.append(k)
                break
        else:
            groups.append([k])
    near = [int((np.hypot(*(places - places[group[0]]).T) < 60).sum()) for group in groups]
    order = sorted(range(len(groups)), key=lambda g: (not is_own[groups[g][0]], -near[g]))
    return [groups[g] for g in order]
