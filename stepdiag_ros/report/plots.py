"""Pictures drawn by Matplotlib: the pages' style, and a figure as SVG text that needs nothing from outside."""

import io
import re

from matplotlib.figure import Figure

INK, SOFT, GRID = '#22282e', '#6b747c', '#e4e7ea'
BEFORE, AFTER = '#c2572f', '#17688a'
STYLE = {'font.family': 'sans-serif', 'font.size': 8.5, 'text.color': INK, 'axes.edgecolor': '#aab2b8',
         'axes.labelcolor': SOFT, 'xtick.color': SOFT, 'ytick.color': SOFT, 'axes.linewidth': 0.7,
         'axes.spines.top': False, 'axes.spines.right': False, 'axes.grid': True, 'grid.color': GRID,
         'grid.linewidth': 0.6, 'axes.axisbelow': True, 'svg.hashsalt': 'stepdiag', 'svg.fonttype': 'path',
         'axes.titlesize': 9, 'axes.titleweight': 'bold', 'axes.titlelocation': 'left',
         'xtick.major.size': 2.5, 'ytick.major.size': 2.5, 'legend.frameon': False}


def svg(figure: Figure) -> str:
    """A figure as an ``<svg>`` element."""
    buffer = io.StringIO()
    figure.savefig(buffer, format='svg', metadata={'Date': None, 'Creator': None}, transparent=True)
    text = re.sub(r'<metadata>.*?</metadata>', '', buffer.getvalue(), flags=re.S)
    return re.sub(r' (width|height)="[\d.]+pt"', '', text[text.index('<svg'):], count=2)
