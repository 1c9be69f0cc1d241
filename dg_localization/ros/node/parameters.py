"""The parameters of the node: one table, from which they are declared, checked and documented."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from importlib import import_module
import math
import re
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from dg_localization.fleet import (
    Anchor,
    FleetConfig,
    LinkKind,
    LinkOverride,
    RangeErrorModel,
)
from dg_localization.ros.node.links import Link, Template, parse_link
from dg_localization.ros.process import WrongParameterError
from dg_localization.solver.result import SolverOptions

STRINGS = Parameter.Type.STRING_ARRAY
DOUBLES = Parameter.Type.DOUBLE_ARRAY
DOUBLE = Parameter.Type.DOUBLE
INTEGER = Parameter.Type.INTEGER
STRING = Parameter.Type.STRING
BOOL = Parameter.Type.BOOL

KINDS = {
    STRINGS: 'a list of strings',
    DOUBLES: 'a list of numbers',
    DOUBLE: 'a number',
    INTEGER: 'an integer',
    STRING: 'a string',
    BOOL: 'true or false',
}
TEMPLATE_TYPES = {
    'range.topic': 'sensor_msgs/msg/Range',
    'bearing.topic': 'geometry_msgs/msg/Vector3Stamped',
    'odometry.topic': 'nav_msgs/msg/Odometry',
    'peers.topic': 'sensor_msgs/msg/PointCloud2',
}
LARGEST_INTEGER = 2**63 - 1
NAME = re.compile(r'[A-Za-z][A-Za-z0-9_]*\Z')


@dataclass(frozen=True)
class Spec:
    """
    One row of the parameter table.

    Attributes
    ----------
    name : str
        Name, with dots.
    type : Parameter.Type
        One of `KINDS`.
    default : object
        Value when it is not given.
    description : str
        One sentence.
    unit : str
        Unit; empty for what has none.
    at_least, at_most : float
        Limits of a number, both included; infinite for none.
    choices : tuple of str
        The allowed strings; empty for any.

    """

    name: str
    type: Parameter.Type
    default: Any
    description: str
    unit: str = ''
    at_least: float = -math.inf
    at_most: float = math.inf
    choices: tuple[str, ...] = ()

    def allowed(self) -> str:
        """Return what the value may be, in words."""
        if self.choices:
            return ' or '.join(f"'{choice}'" for choice in self.choices)
        limits = []
        if self.at_least > -math.inf:
            limits.append(f'>= {self.at_least:g}')
        if self.at_most < math.inf:
            limits.append(f'<= {self.at_most:g}')
        return ' '.join([KINDS[self.type], ' and '.join(limits)]).strip() + self._in_unit()

    def _in_unit(self) -> str:
        return f' ({self.unit})' if self.unit else ''

    def check(self, value: Any) -> Any:
        """
        Return `value` with the type of the table.

        An integer is taken for a number and `[]`, which arrives as None, for an empty list, as
        a person writing YAML means them.

        Raises
        ------
        WrongParameterError
            If the value is not allowed.

        """
        if self.type in (STRINGS, DOUBLES):
            value = [] if value is None else list(value)
        if self.type is DOUBLE and type(value) is int:
            value = float(value)
        if self.type is DOUBLES and all(type(item) in (int, float) for item in value):
            value = [float(item) for item in value]
        if not self._fits(value):
            raise WrongParameterError(
                f"parameter '{self.name}': {value!r} is not allowed, it must be {self.allowed()}"
            )
        return value

    def _fits(self, value: Any) -> bool:
        if self.type is STRINGS:
            return all(type(item) is str for item in value)
        if self.type is DOUBLES:
            return all(type(item) is float and math.isfinite(item) for item in value)
        if self.type in (DOUBLE, INTEGER):
            number = float if self.type is DOUBLE else int
            return type(value) is number and self.at_least <= value <= self.at_most
        if self.type is BOOL:
            return type(value) is bool
        return type(value) is str and (not self.choices or value in self.choices)

    def descriptor(self) -> ParameterDescriptor:
        """Return the descriptor that `ros2 param describe` shows; all are read-only."""
        descriptor = ParameterDescriptor(
            description=self.description + self._in_unit(),
            additional_constraints=self.allowed() if self.choices else '',
            type=self.type.value,
            read_only=True,
            # The type of an empty list cannot be told from its value.
            dynamic_typing=self.type in (STRINGS, DOUBLES),
        )
        bounded = math.isfinite(self.at_least) or math.isfinite(self.at_most)
        if self.type is DOUBLE and bounded:
            limits = FloatingPointRange(from_value=self.at_least, to_value=self.at_most)
            descriptor.floating_point_range = [limits]
        if self.type is INTEGER and bounded:
            at_most = int(min(self.at_most, LARGEST_INTEGER))
            limits = IntegerRange(from_value=int(self.at_least), to_value=at_most, step=1)
            descriptor.integer_range = [limits]
        return descriptor


TABLE = (
    Spec('robots', STRINGS, [], 'names of the robots; the order of all outputs'),
    Spec(
        'dimension',
        INTEGER,
        2,
        'dimension of the space the robots move in',
        at_least=2,
        at_most=3,
    ),
    Spec('fixed_frame', STRING, 'map', 'frame_id of everything that is published'),
    Spec(
        'reference_robot',
        STRING,
        '',
        'robot at the origin when the anchors do not fix the frame; empty for the first',
    ),
    Spec('rate', DOUBLE, 5.0, 'how often the fleet is localized', 'Hz', 0.01, 1000.0),
    Spec('max_age', DOUBLE, 1.0, 'older measurements are not used', 's', 0.0),
    Spec('max_future', DOUBLE, 0.1, 'how far a stamp may lie ahead of the clock', 's', 0.0),
    Spec(
        'max_repeats', INTEGER, 8, 'newest readings of one input kept and intersected', at_least=1
    ),
    Spec(
        'stamp_source',
        STRING,
        'header',
        'time of a measurement: its header, or its arrival where headers are empty or wrong',
        choices=('header', 'receive'),
    ),
    Spec('max_speed', DOUBLE, 1.0, 'no robot moves faster', 'm/s', 0.0),
    Spec('max_turn_rate', DOUBLE, 1.0, 'no robot turns faster', 'rad/s', 0.0),
    Spec('min_separation', DOUBLE, 0.0, 'no two robots come nearer than this', 'm', 0.0),
    Spec(
        'range.topic',
        STRING,
        '/{observer}/range/{target}',
        'template of the topics of type sensor_msgs/Range; empty for none',
    ),
    Spec('range.min_error', DOUBLE, 0.0, 'least error (reading - truth) of a range', 'm'),
    Spec('range.max_error', DOUBLE, 0.0, 'greatest error (reading - truth) of a range', 'm'),
    Spec('range.min_error_relative', DOUBLE, -0.03, 'least error as a fraction of the reading'),
    Spec(
        'range.max_error_relative',
        DOUBLE,
        0.03,
        'greatest error as a fraction of the reading',
        at_most=1.0,
    ),
    Spec(
        'range.sigma_factor',
        DOUBLE,
        0.0,
        'standard deviations (of Range.variance) added on both sides; 0 ignores the variance',
        at_least=0.0,
    ),
    Spec(
        'range.beyond_max_is_far',
        BOOL,
        False,
        'whether +inf (REP-117) proves that the target is farther than max_range',
    ),
    Spec(
        'bearing.topic',
        STRING,
        '/{observer}/bearing/{target}',
        'template of the topics of type geometry_msgs/Vector3Stamped; empty for none',
    ),
    Spec(
        'bearing.half_width',
        DOUBLE,
        0.05,
        'greatest angle between a ray and the true direction',
        'rad',
        0.0,
        math.pi,
    ),
    Spec(
        'odometry.topic',
        STRING,
        '/{robot}/odom',
        'template of the topics of type nav_msgs/Odometry; empty for none',
    ),
    Spec(
        'odometry.relative_error',
        DOUBLE,
        0.05,
        'greatest error of odometry as a fraction of the way and the turn at full speed',
        at_least=0.0,
    ),
    Spec(
        'peers.topic',
        STRING,
        '/{observer}/peers',
        'template of the topics of type sensor_msgs/PointCloud2 with all that one robot measures; '
        'empty for none',
    ),
    Spec(
        'links',
        STRINGS,
        [],
        "inputs named one by one, 'TOPIC TYPE OBSERVER [TARGET] [NAME=VALUE ...]'; "
        'each replaces what the templates give for the same measurement',
    ),
    Spec(
        'adapter_modules',
        STRINGS,
        [],
        'Python modules to import at start, which register adapters of message types',
    ),
    Spec('anchors.names', STRINGS, [], 'points whose coordinates are known'),
    Spec('anchors.bound', DOUBLE, 0.0, 'how far an anchor may be from its coordinates', 'm', 0.0),
    Spec('max_outliers', INTEGER, 0, 'how many contradicting inputs may be dropped', at_least=0),
    Spec(
        'conflicts.max_solves',
        INTEGER,
        200,
        'problems solved at most to explain one contradiction; 0 explains none',
        at_least=0,
    ),
    Spec(
        'conflicts.max_seconds', DOUBLE, 2.0, 'longest time to explain a contradiction', 's', 0.0
    ),
    Spec('max_hypotheses', INTEGER, 64, 'how many placements are published', at_least=1),
    Spec(
        'solver.resolution', DOUBLE, 0.05, 'width of a distance not split further', 'm', 1e-6, 1e6
    ),
    Spec('solver.max_boxes', INTEGER, 2000, 'boxes processed at most', at_least=1),
    Spec('solver.max_seconds', DOUBLE, 1.0, 'longest time of one solve', 's', 0.001),
    Spec(
        'solver.tighten_slices',
        INTEGER,
        20,
        'slices examined of each finished box, to tighten it',
        at_least=0,
    ),
    Spec('autostart', BOOL, True, 'configure and activate without being told to'),
)


def anchor_table(name: str) -> tuple[Spec, Spec]:
    """Return the parameters of one anchor; a negative bound stands for `anchors.bound`."""
    return (
        Spec(f'anchors.{name}.position', DOUBLES, [], 'coordinates in the fixed frame', 'm'),
        Spec(
            f'anchors.{name}.bound',
            DOUBLE,
            -1.0,
            'how far it may be from there; negative for anchors.bound',
            'm',
        ),
    )


def robot_spec(name: str) -> Spec:
    """Return the parameter of one robot; a negative speed stands for `max_speed`."""
    return Spec(
        f'robot_max_speed.{name}',
        DOUBLE,
        -1.0,
        'this robot moves no faster; negative for max_speed',
        'm/s',
    )


@dataclass(frozen=True)
class Settings:
    """
    The checked parameters.

    Attributes
    ----------
    fleet : FleetConfig
        What the ROS-free part is told.
    links : tuple of Link
        The inputs named one by one.
    templates : tuple of Template
        What the topics of all others are named like.
    fixed_frame : str
        frame_id of everything that is published.
    rate_hz : float
        How often the fleet is localized.
    use_header_stamp : bool
        Whether a measurement's time is its header's, not that of its arrival.
    autostart : bool
        Whether to configure and activate at once.

    """

    fleet: FleetConfig
    links: tuple[Link, ...]
    templates: tuple[Template, ...]
    fixed_frame: str
    rate_hz: float
    use_header_stamp: bool
    autostart: bool


def declare_settings(node: Node) -> Settings:
    """
    Declare every parameter of the table and return the settings.

    Raises
    ------
    WrongParameterError
        If a parameter is unknown or has a value it cannot have. The message names it, the
        value and the allowed values.

    """
    # rclpy offers no public way to the values given at start before they are declared, and
    # declares no parameter that was given with a type other than its own.
    given = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
    values = check_values(given, ignored=[name for name in given if node.has_parameter(name)])
    settings = settings_from(values)
    for spec in (*TABLE, *_tables_of_names(values)):
        node.declare_parameter(
            spec.name, values[spec.name], spec.descriptor(), ignore_override=True
        )
    return settings


def check_values(given: Mapping[str, Any], ignored: Iterable[str] = ()) -> dict[str, Any]:
    """
    Return the value of every parameter of the table, given or default.

    Parameters
    ----------
    given : mapping of str to object
        What the user sets.
    ignored : iterable of str
        Names in `given` that belong to others, such as use_sim_time.

    Raises
    ------
    WrongParameterError
        If a name is not in the table or a value is not allowed.

    """
    values = {spec.name: spec.check(given.get(spec.name, spec.default)) for spec in TABLE}
    for spec in _tables_of_names(values):
        values[spec.name] = spec.check(given.get(spec.name, spec.default))
    known = {*values, *ignored}
    for name in given:
        if name not in known and not name.startswith('qos_overrides.'):
            raise WrongParameterError(f"parameter '{name}' is unknown{_suggestion(name, known)}")
    return values


def _suggestion(name: str, known: Iterable[str]) -> str:
    if name.startswith('anchors.'):
        wanted = 'anchors.NAME.position or anchors.NAME.bound'
        return f"; name the anchor in 'anchors.names' and set {wanted}"
    if name.startswith('robot_max_speed.'):
        return "; name the robot in 'robots'"
    close = get_close_matches(name, list(known), n=1)
    return f"; did you mean '{close[0]}'?" if close else ''


def _tables_of_names(values: Mapping[str, Any]) -> list[Spec]:
    """Return the parameters of each robot and of each anchor."""
    robots = (robot_spec(name) for name in values['robots'])
    anchors = (spec for name in values['anchors.names'] for spec in anchor_table(name))
    return [*robots, *anchors]


def settings_from(values: Mapping[str, Any]) -> Settings:
    """
    Return the settings that checked `values` stand for, with all adapters at hand.

    Raises
    ------
    WrongParameterError
        If values do not go together.

    """
    for name in ('robots', 'anchors.names'):
        _check_names(name, values[name])
    _import_adapters(values['adapter_modules'])
    explicit = _parse_links(values['links'])
    try:
        fleet = _fleet_config(values, explicit)
    except ValueError as error:
        raise WrongParameterError(f'parameters: {error}') from None
    return Settings(
        fleet=fleet,
        links=explicit,
        templates=_templates(values),
        fixed_frame=values['fixed_frame'],
        rate_hz=values['rate'],
        use_header_stamp=values['stamp_source'] == 'header',
        autostart=values['autostart'],
    )


def _import_adapters(modules: Iterable[str]) -> None:
    for name in filter(None, modules):
        try:
            import_module(name)
        except Exception as error:  # a module of somebody else may raise anything
            raise WrongParameterError(
                f"parameter 'adapter_modules': '{name}' cannot be imported "
                f'({type(error).__name__}: {error}); it must be a Python module that is installed '
                'or in a folder of PYTHONPATH'
            ) from error


def _parse_links(texts: Iterable[str]) -> tuple[Link, ...]:
    links = []
    # A list of one empty string is how ROS 1 and 2 users write an empty list of strings.
    for text in filter(None, texts):
        try:
            links.append(parse_link(text))
        except ValueError as error:
            raise WrongParameterError(
                f"parameter 'links': '{text}' is not allowed: {error}"
            ) from None
    topics = [link.topic for link in links]
    for topic in topics:
        if topics.count(topic) > 1:
            raise WrongParameterError(
                f"parameter 'links': topic '{topic}' is named twice, it can carry one link only"
            )
    return tuple(links)


def _templates(values: Mapping[str, Any]) -> tuple[Template, ...]:
    templates: dict[str, Template] = {}
    for name, type_name in TEMPLATE_TYPES.items():
        template = Template(values[name], type_name)
        try:
            template.check()
            if template.text in templates:
                raise ValueError('each kind of measurement needs topics of its own')
        except ValueError as error:
            raise WrongParameterError(
                f"parameter '{name}': '{template.text}' is not allowed, {error}"
            ) from None
        if template.text:
            templates[template.text] = template
    return tuple(templates.values())


def _check_names(parameter: str, names: Iterable[str]) -> None:
    for name in names:
        if not NAME.match(name):
            raise WrongParameterError(
                f"parameter '{parameter}': '{name}' is not allowed, a name must begin with a "
                'letter and go on with letters, digits and underscores: it is part of topic names'
            )


def _fleet_config(values: Mapping[str, Any], explicit: Iterable[Link]) -> FleetConfig:
    anchors = {name: _anchor(name, values) for name in values['anchors.names']}
    points = {*values['robots'], *anchors}
    return FleetConfig(
        robots=tuple(values['robots']),
        dimension=values['dimension'],
        reference_robot=values['reference_robot'],
        max_age_s=values['max_age'],
        max_future_s=values['max_future'],
        max_repeats=values['max_repeats'],
        range_error=_range_error(values),
        bearing_half_width_rad=values['bearing.half_width'],
        # A link may name a robot that is not in the fleet today: its readings are counted and
        # rejected, its bounds concern nobody.
        links=_overrides((link for link in explicit if _ends(link) <= points), values),
        anchors=anchors,
        max_speed_m_s=values['max_speed'],
        robot_max_speed_m_s=_robot_speeds_m_s(values),
        max_turn_rate_rad_s=values['max_turn_rate'],
        min_separation_m=values['min_separation'],
        odometry_relative_error=values['odometry.relative_error'],
        max_hypotheses=values['max_hypotheses'],
        max_outliers=values['max_outliers'],
        max_conflict_solves=values['conflicts.max_solves'],
        max_conflict_seconds=values['conflicts.max_seconds'],
        solver=SolverOptions(
            resolution=values['solver.resolution'],
            max_boxes=values['solver.max_boxes'],
            max_seconds=values['solver.max_seconds'],
            tighten_slices=values['solver.tighten_slices'],
        ),
    )


def _robot_speeds_m_s(values: Mapping[str, Any]) -> dict[str, float]:
    speeds = {name: values[f'robot_max_speed.{name}'] for name in values['robots']}
    return {name: speed for name, speed in speeds.items() if speed >= 0.0}


def _range_error(values: Mapping[str, Any], **overrides: float) -> RangeErrorModel:
    names = (
        'min_error',
        'max_error',
        'min_error_relative',
        'max_error_relative',
        'sigma_factor',
    )
    bounds = {name: overrides.get(name, values[f'range.{name}']) for name in names}
    return RangeErrorModel(
        min_error_m=bounds['min_error'],
        max_error_m=bounds['max_error'],
        min_error_relative=bounds['min_error_relative'],
        max_error_relative=bounds['max_error_relative'],
        sigma_factor=bounds['sigma_factor'],
        beyond_max_is_far=values['range.beyond_max_is_far'],
    )


def _overrides(links: Iterable[Link], values: Mapping[str, Any]) -> tuple[LinkOverride, ...]:
    """Gather the bounds of ranges and of bearings between the same two points."""
    gathered: dict[tuple[str, str], LinkOverride] = {}
    for link in links:
        names = (link.key.observer, link.key.target)
        if link.key.kind is LinkKind.BEARING and link.overrides:
            bounds: dict[str, Any] = {'bearing_half_width_rad': link.overrides['half_width']}
        elif link.key.kind is LinkKind.RANGE and link.overrides:
            bounds = {'range_error': _range_error(values, **link.overrides)}
        else:
            continue
        gathered[names] = replace(gathered.get(names, LinkOverride(*names)), **bounds)
    return tuple(gathered.values())


def _ends(link: Link) -> set[str]:
    return {link.key.observer, link.key.target}


def _anchor(name: str, values: Mapping[str, Any]) -> Anchor:
    bound = values[f'anchors.{name}.bound']
    return Anchor(
        coordinates_m=tuple(values[f'anchors.{name}.position']),
        bound_m=bound if bound >= 0.0 else values['anchors.bound'],
    )
