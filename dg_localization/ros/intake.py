"""From what an adapter read to what the ROS-free `Localizer` takes."""

from dg_localization.fleet import LinkKey, Localizer, Rejection
from msg_adapters import BearingReading, OdometryReading, RangeReading

Reading = RangeReading | BearingReading | OdometryReading


def add_reading(
    localizer: Localizer, key: LinkKey, reading: Reading, stamp_s: float, now_s: float
) -> Rejection | None:
    """
    Give one reading to a localizer.

    Parameters
    ----------
    localizer : Localizer
    key : LinkKey
        Who measured whom; nothing in the reading itself says so.
    reading : RangeReading, BearingReading or OdometryReading
    stamp_s : float
        When it was measured; the reading's own stamp may be useless.
    now_s : float
        The time now, on the same clock.

    Returns
    -------
    Rejection or None
        Why it was not taken.

    """
    match reading:
        case RangeReading():
            return localizer.add_range(
                key.observer,
                key.target,
                reading.range_m,
                stamp_s,
                now_s,
                min_range_m=reading.min_range_m,
                max_range_m=reading.max_range_m,
                variance_m2=reading.variance_m2,
            )
        case BearingReading():
            return localizer.add_bearing(key.observer, key.target, reading.ray_xyz, stamp_s, now_s)
        case OdometryReading():
            return localizer.add_odometry(
                key.observer, reading.position_xyz, reading.orientation_xyzw, stamp_s, now_s
            )
