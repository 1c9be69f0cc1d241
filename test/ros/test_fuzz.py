# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Whatever is sent is counted, and only readings that can be true enter the problem."""

from functools import partial
import os
from random import Random

from estimates import AS_MAP, report_on
from hostile_messages import BEARING, CLOUD, IDS, ODOMETRY, RANGE, HostileFleet, replaced
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from shapes import check_form

from dg_localization import Verdict
from dg_localization.fleet import Localizer
from dg_localization.fleet.constraints.constrain import constrain
from dg_localization.ros.interface.diagnostics import statuses
from dg_localization.ros.interface.intake import Intake
from dg_localization.ros.interface.outputs import estimate_messages
from msg_adapters import Diagnostics, adapter_for
from msg_adapters.diagnostics import diagnostics_to_cdr

# The long run: DG_FUZZ_INPUTS=10000000 make test PYTEST_ARGS=test/ros/test_fuzz.py
INPUTS = int(os.environ.get('DG_FUZZ_INPUTS', '48000'))
INPUTS_PER_FLEET = 500
TESTS = 8
FLEETS_PER_TEST = max(1, INPUTS // INPUTS_PER_FLEET // TESTS // 2)
PARTS = [range(k * FLEETS_PER_TEST, (k + 1) * FLEETS_PER_TEST) for k in range(TESTS)]
TOLERANCE_M = 1e-7


@pytest.fixture
def serialized(third_party_messages, monkeypatch):
    """Serialize messages; those of packages that are not installed arrive as they are."""
    arriving = {}

    def deserialize(data, message_class):
        found = arriving.get(data)
        return deserialize_message(data, message_class) if found is None else found

    def serialized(message):
        if hasattr(message, 'get_fields_and_field_types'):
            return bytes(serialize_message(message))
        data = f'message {len(arriving)}'.encode()
        arriving[data] = message
        return data

    monkeypatch.setattr('dg_localization.ros.interface.intake.deserialize_message', deserialize)
    return serialized


class Taker:
    """An intake of a fleet that knows its cameras, and what it should have counted by now."""

    def __init__(self, fleet):
        self.fleet = fleet
        self.localizer = Localizer(fleet.config)
        self.intake = Intake(self.localizer, True, fleet.ids)
        for link in fleet.cameras:
            data = bytes(serialize_message(fleet.true_message(link)))
            assert self.intake.take(link, data, fleet.now_s) is None
        self.wanted = self.counted

    def take(self, link, data):
        malformed, counted = self.malformed(link), self.counted if link.type_name in IDS else 0
        rejection = self.intake.take(link, data, self.fleet.now_s)
        if self.malformed(link) > malformed:
            assert rejection is None
            self.wanted += 1
        elif link.type_name in IDS:
            # It may have measured no robot, or none that counts.
            assert self.counted >= counted
            self.wanted += self.counted - counted
        else:
            self.wanted += self.readings_in(link, data)
        return rejection

    def malformed(self, link):
        found = self.intake.malformed.get(link.topic)
        return found.count if found else 0

    def readings_in(self, link, data):
        """Return how many counts a message is worth: a row of peers counts twice."""
        if link.type_name != CLOUD:
            return 1
        adapter = adapter_for(CLOUD)
        peers = adapter.from_message(deserialize_message(data, adapter.message_class()))
        config, age_s = self.fleet.config, self.fleet.now_s - peers.stamp_s
        in_time = -config.max_future_s <= age_s <= config.max_age_s and peers.stamp_s != 0.0
        if link.key.observer not in config.points or not in_time:
            return 1
        has_ray = ~np.isnan(peers.rays_xyz).all(axis=1)
        has_range = ~np.isnan(peers.ranges_m) | ~has_ray
        return 2 * int(has_ray.sum() + has_range.sum())

    @property
    def counted(self):
        states = self.intake.states(self.fleet.now_s).values()
        read = sum(state.accepted + sum(state.rejected.values()) for state in states)
        return read + sum(wrong.count for wrong in self.intake.malformed.values())

    def check(self):
        """Assert that what is known now, and the answer to it, are well formed; return both."""
        snapshot = self.localizer.snapshot(self.fleet.now_s)
        check_snapshot(snapshot)
        estimate = self.localizer.estimate(snapshot)
        check_estimate(estimate, self)
        return snapshot, estimate


def check_snapshot(snapshot):
    """Assert that every reading in a snapshot is one, whatever was sent."""
    for reading in snapshot.distances:
        assert not np.isnan([reading.lower_m, reading.upper_m]).any()
        assert 0.0 <= reading.lower_m < np.inf
    for ray in snapshot.rays:
        assert abs(np.linalg.norm(ray.direction) - 1.0) < 1e-12
        assert 0.0 <= ray.half_width_rad <= np.pi and ray.displacement_m >= 0.0
    for track in snapshot.motion.odometry.values():
        stamps_s = [reading.stamp_s for reading in track]
        assert stamps_s == sorted(set(stamps_s))
        for reading in track:
            assert np.isfinite(reading.position_m).all()
            assert np.allclose(reading.rotation @ reading.rotation.T, np.eye(3), atol=0.05)
    known = constrain(snapshot)
    assert not np.isnan(known.lower).any() and not np.isnan(known.upper).any()
    assert (known.lower >= 0.0).all()


def check_estimate(estimate, taker):
    """Assert that an estimate is well formed, and can be published and reported."""
    for placement in estimate.placements:
        check_form(placement)
    assert all(data for _, data in estimate_messages(estimate, AS_MAP))
    now_s = taker.fleet.now_s
    report = report_on(
        estimate,
        now_s=now_s,
        robots=taker.fleet.config.robots,
        links=tuple(taker.fleet.links),
        inputs=taker.intake.states(now_s),
        malformed=taker.intake.malformed,
    )
    data = diagnostics_to_cdr(Diagnostics(now_s, statuses(report)))
    assert len(data) < 1000 * (len(taker.fleet.links) + 20)


def holds_truth(placement, fleet):
    """Return whether true distances are possible between the enclosures of a placement."""
    enclosures_m = np.concatenate([placement.enclosure_m, placement.landmark_enclosure_m])
    low, high = np.moveaxis(enclosures_m, 1, 0)
    norms = partial(np.linalg.norm, axis=-1)
    apart_m = norms(fleet.positions_m[:, None] - fleet.positions_m)
    least_m = norms(np.maximum(low[:, None] - high, low - high[:, None]).clip(0.0))
    most_m = norms(np.maximum(high[:, None] - low, high - low[:, None]))
    off = ~np.eye(len(apart_m), dtype=bool)
    inside = (least_m - TOLERANCE_M <= apart_m) & (apart_m <= most_m + TOLERANCE_M)
    return bool(inside[off].all())


def same_readings(first, second):
    """Assert that two snapshots contain the same readings, to the last bit."""
    assert first.distances == second.distances
    assert [ray.key for ray in first.rays] == [ray.key for ray in second.rays]
    for ray, other in zip(first.rays, second.rays, strict=True):
        assert np.array_equal(ray.direction, other.direction) and ray.stamp_s == other.stamp_s
    one, two = constrain(first), constrain(second)
    assert np.array_equal(one.lower, two.lower) and np.array_equal(one.upper, two.upper)


def check_truth_is_kept(among_others, alone, seed):
    """Assert that the one taker knows what the other does, and that its answer has the truth."""
    fleet = among_others.fleet
    snapshot, estimate = among_others.check()
    same_readings(snapshot, alone.localizer.snapshot(fleet.now_s))
    assert estimate.verdict is not Verdict.INFEASIBLE, seed
    if estimate.placements:
        assert any(holds_truth(placement, fleet) for placement in estimate.placements), seed


@pytest.mark.parametrize('seeds', PARTS, ids=range(TESTS))
def test_useless_messages_change_nothing_and_the_truth_is_kept(serialized, seeds):
    for seed in seeds:
        fleet = HostileFleet.make(seed)
        among_others, alone = Taker(fleet), Taker(fleet)
        for _ in range(INPUTS_PER_FLEET):
            fleet.pass_time()
            link = fleet.random.choice(fleet.links)
            if fleet.random.random() < 0.5:
                among_others.take(link, serialized(fleet.useless_message(link)))
                link = fleet.random.choice(fleet.strangers)
                among_others.take(link, serialized(fleet.true_message(link)))
            else:
                message, before = fleet.true_message(link), alone.wanted
                data = serialized(message)
                assert among_others.take(link, data) is None, seed
                assert alone.take(link, data) is None, seed
                assert not alone.malformed(link), (seed, alone.intake.malformed)
                sees_none = not getattr(message, 'detections', True)
                assert alone.wanted > before or sees_none, seed
        assert among_others.counted == among_others.wanted, seed
        check_truth_is_kept(among_others, alone, seed)


@pytest.mark.parametrize('seeds', PARTS, ids=range(TESTS))
def test_anything_at_all_is_counted_and_answered(serialized, seeds):
    for seed in seeds:
        fleet = HostileFleet.make(seed)
        taker = Taker(fleet)
        for _ in range(INPUTS_PER_FLEET):
            fleet.pass_time()
            links = fleet.links if fleet.random.random() < 0.95 else fleet.strangers
            link = fleet.random.choice(links)
            data = serialized(fleet.any_message(link))
            damaged = fleet.random.random() < 0.3
            taker.take(link, fleet.damaged(data) if damaged else data)
        assert taker.counted == taker.wanted > INPUTS_PER_FLEET // 2, seed
        taker.check()


class Raises:
    """A value of an adapter of somebody else that cannot be used for anything."""

    def __getattr__(self, name):
        raise RuntimeError(name)

    def __float__(self):
        raise RuntimeError('no number')


NONSENSE = (
    *(None, True, '3 m', b'3', 'nan', [], [3.0], (3.0, 4.0), {}, {3.0}, 3, 10**400, -1, 3 + 4j),
    *(Raises(), object(), float, np.float32(3.0), np.array(3.0), np.array([3.0]), np.arange(9.0)),
    *(np.array([1.0, 2.0, 3.0], object), np.array(['a', 'b', 'c']), np.ones((3, 3)), np.ones(0)),
    *(np.ma.masked, np.datetime64('2026-01-01'), np.full(3, np.nan), np.float64('inf'), range(3)),
    *(np.array([1 + 1j, 0, 0]), np.array([10**400, 0, 0], object), np.ones(4), [[1.0], [0.0], []]),
    *([1.0, None, 0.0], ['1', '0', '0'], np.array([None, None, None]), np.ones(4) / 2, np.eye(4)),
)
TYPES = (RANGE, BEARING, ODOMETRY, CLOUD, *IDS)
READERS = {name: adapter_for(name).from_message for name in TYPES}


def partly_nonsense(random, value):
    """Return a reading with some of its values replaced by nonsense."""
    fields = list(vars(value))
    names = random.sample(fields, random.choice((0, 1, 1, 2, len(fields))))
    wrong = replaced(value, **{name: random.choice(NONSENSE) for name in names})
    return wrong if random.random() < 0.95 else random.choice(NONSENSE)


def test_nonsense_of_adapters_is_counted_and_never_enters(serialized, adapt):
    random = Random(1)
    for seed in range(FLEETS_PER_TEST // 2):
        fleet = HostileFleet.make(seed)
        taker = Taker(fleet)
        for _ in range(INPUTS_PER_FLEET):
            fleet.pass_time()
            link = random.choice(fleet.links)
            message = fleet.true_message(link)
            value = partly_nonsense(random, READERS[link.type_name](message))
            before = taker.counted, taker.malformed(link)
            adapt(link.type_name, lambda _, value=value: value)
            taker.intake.take(link, serialized(message), fleet.now_s)
            if taker.malformed(link) > before[1]:
                assert taker.counted == before[0] + 1, value
        taker.check()
