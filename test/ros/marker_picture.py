# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Draws a visualization_msgs/MarkerArray from above, as RViz and Foxglove would."""

import numpy as np
from visualization_msgs.msg import Marker

BACKGROUND = '#303030'
POINTS_PER_INCH = 72.0


def draw(array, path, half_width_m):
    """Draw the markers of an array into a file; one metre is as long in both directions."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot
    from matplotlib.collections import LineCollection, PatchCollection
    from matplotlib.patches import Circle

    inches = 8.0
    figure = pyplot.figure(figsize=(inches, inches), facecolor=BACKGROUND)
    panel = figure.add_axes((0.0, 0.0, 1.0, 1.0), facecolor=BACKGROUND)
    panel.set_xlim(-half_width_m, half_width_m)
    panel.set_ylim(-half_width_m, half_width_m)
    per_metre = inches * POINTS_PER_INCH / (2.0 * half_width_m)
    for marker in array.markers:
        points = np.array([[p.x, p.y] for p in marker.points]).reshape(-1, 2)
        colors = [(c.r, c.g, c.b, c.a) for c in marker.colors]
        if marker.type == Marker.LINE_LIST and len(points):
            width = marker.scale.x * per_metre
            lines = LineCollection(points.reshape(-1, 2, 2), colors=colors[::2], linewidths=width)
            panel.add_collection(lines)
        elif marker.type == Marker.SPHERE_LIST:
            circles = [Circle(point, marker.scale.x / 2.0) for point in points]
            panel.add_collection(PatchCollection(circles, facecolors=colors, zorder=3))
        elif marker.type == Marker.TEXT_VIEW_FACING:
            c, place = marker.color, marker.pose.position
            size = marker.scale.z * per_metre
            text = {'color': (c.r, c.g, c.b, c.a), 'fontsize': size, 'ha': 'center'}
            panel.text(place.x, place.y, marker.text, va='center', zorder=4, **text)
    figure.savefig(path, facecolor=BACKGROUND, dpi=100)
    pyplot.close(figure)
