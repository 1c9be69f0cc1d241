# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What is off by its bound in a drawn history: clocks, stamps of odometry, places of anchors."""

from dataclasses import replace
import math

from drives import SAMPLE_S
import numpy as np

LATENCIES_S = (0.0, 0.0, 0.03, 0.045)
ANCHOR_BOUNDS_M = (0.0, 0.0, 0.05, 0.5)


def draw_clocks(seed, robots):
    """Draw how far clocks may be wrong, and how far they are."""
    rng = np.random.default_rng(seed)
    error_s = float(rng.choice([0.0, 0.0, 0.005, 0.05]))
    return error_s, (0.999 * error_s * rng.choice([-1.0, 0.3, 1.0], robots)).tolist()


def draw_late(rng, count, latency_s):
    """Draw how much later than true each sample of an odometry is stamped; their order stays."""
    if latency_s > 0.3 * SAMPLE_S:
        return 0.999 * latency_s * np.cos(rng.uniform(0.0, 6.0) + 0.3 * np.arange(count))
    return 0.999 * latency_s * rng.choice([-1.0, 0.5, 1.0], count)


def draw_off(rng, anchor):
    """Draw where an anchor truly is, seen from where it is said to be."""
    off = rng.normal(size=len(anchor.coordinates_m))
    return 0.999 * anchor.bound_m * off / np.linalg.norm(off)


def turned_about_z(mount, angle_rad):
    half_rad = 0.5 * angle_rad
    return replace(mount, rotation_xyzw=(0.0, 0.0, math.sin(half_rad), math.cos(half_rad)))


def fastest_m_s(history, robot):
    """Return the greatest speed of a robot between two samples."""
    samples = range(len(history.drives[robot].true))
    places = np.array([history.place(robot, k * SAMPLE_S) for k in samples])
    _, swing_m, frequency_rad_s, _ = history.heights.waves.get(f'r{robot}', (0.0,) * 4)
    level_m_s = np.linalg.norm(np.diff(places, axis=0), axis=1).max() / SAMPLE_S
    return 1.001 * math.hypot(level_m_s, swing_m * frequency_rad_s)


def fastest_turn_rad_s(history):
    """Return the greatest turn rate of the robots of a plane between two samples."""
    return 1.001 * max(np.abs(np.diff(d.true[:, 2])).max() for d in history.drives) / SAMPLE_S


def draw_limits(history, seed):
    """Return a history whose robots, in half of the seeds, are no faster than they have to be."""
    config = history.config
    if np.random.default_rng([seed, 11]).random() < 0.5:
        return history
    rows = range(len(config.robots))
    config = replace(
        config, robot_max_speed_m_s={config.robots[k]: fastest_m_s(history, k) for k in rows}
    )
    if config.dimension == 2:
        config = replace(config, max_turn_rate_rad_s=fastest_turn_rad_s(history))
    history.config = config
    return history


def draw_offsets(history, seed):
    """
    Return a history with the offsets that a seed draws, and with the bounds that hold for them.

    In the plane cameras on mounts are turned, too.
    """
    rng = np.random.default_rng([seed, 10])
    config = history.config
    latencies_s = rng.choice(LATENCIES_S, len(config.robots)).tolist()
    errors = {
        robot: replace(config.robot_odometry_error.get(robot, config.odometry_error), latency_s=s)
        for robot, s in zip(config.robots, latencies_s, strict=True)
    }
    history.late_s = [
        draw_late(rng, len(drive.true), s)
        for drive, s in zip(history.drives, latencies_s, strict=True)
    ]
    bound_m = float(rng.choice(ANCHOR_BOUNDS_M))
    anchors = {name: replace(anchor, bound_m=bound_m) for name, anchor in config.anchors.items()}
    history.off_m = {name: draw_off(rng, anchor) for name, anchor in anchors.items()}
    mounts = config.mounts
    if config.dimension == 2:
        mounts = {
            robot: {
                name: turned_about_z(mount, rng.uniform(-3.0, 3.0))
                for name, mount in sensors.items()
            }
            for robot, sensors in mounts.items()
        }
    history.config = replace(config, robot_odometry_error=errors, anchors=anchors, mounts=mounts)
    return history


def at_its_bounds(history, seed):
    """Return a history with offsets, and with limits of speed that hold only just."""
    return draw_limits(draw_offsets(history, seed), seed)
