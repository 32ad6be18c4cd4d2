"""A legend beside the axes of a figure, by Matplotlib 3.6 too."""

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

ROOM_IN = 0.35
"""Height [inch] kept free for one line of entries where Matplotlib does not do it."""


def legend_outside(figure: Figure, handles: Sequence[Any], labels: Sequence[str], where: str, **options: Any) -> None:
    """Draw the legend ``where`` (``upper left`` …) above or below the axes of a figure with constrained layout."""
    try:
        figure.legend(handles, labels, loc=f'outside {where}', **options)
    except ValueError:   # before 3.7
        share = min(0.3, ROOM_IN / figure.get_figheight())
        figure.get_layout_engine().set(rect=(0.0, share if 'lower' in where else 0.0, 1.0, 1.0 - share))
        figure.legend(handles, labels, loc=where, **options)
