"""A scenario in words, and as the TOML file that holds all its values with their meaning and range."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from typing import Any

from pydantic import BaseModel

from mavdem.cli.output import printable
from sitl_scenarios.files import KINDS
from sitl_scenarios.scenario import Gust, Moment, Scenario, VehicleSpec, Wind

VEHICLES = {"ardrone2": "AR.Drone 2.0", "iris": "3DR Iris", "crazyflie": "Crazyflie 2"}
FRAMES = {"x": "X", "plus": "+"}
AUTOPILOTS = {"px4": "PX4", "ardupilot": "ArduPilot"}
WINDS = {
    "steady": "{speed:g} m/s from {direction:g}°",
    "gaussian": "noise of {sd:g} m/s along each axis, its kernel {s:g} s",
    "dryden": "{speed:g} m/s from {direction:g}° with Dryden turbulence for {wind_at_20_feet:g} m/s at 20 feet",
    "von_karman": "{speed:g} m/s from {direction:g}° with von Kármán turbulence for {wind_at_20_feet:g} m/s at 20 feet",
    "gust": "a gust of {speed:g} m/s from {direction:g}° that begins at {start:g} s, rises in {rise:g} s and "
    "stays {stays}",
    "jet": "a blower's jet of {speed:g} m/s from {direction:g}°, its mouth {diameter:g} m wide and {distance:g} m "
    "away, its axis {offset:g} m to the right, turbulent by {turbulence:.0%} with a kernel of {s:g} s",
}
EXCITATIONS = {
    "doublets": "doublets of {amplitude:g}{demand}, {width:g} s to each side, every {period:g} s",
    "chirp": "a sine of {amplitude:g}{demand}, from {lowest:g} to {highest:g} Hz every {period:g} s",
    "multisine": "sines of {sd:g}{demand} together, from {lowest:g} to {highest:g} Hz, again every {period:g} s",
    "steps": "{distance:g} m sideways and back every {period:g} s",
    "sticks": "a pilot's sticks, irregular demands of {sd:g}{demand}, their kernel {s:g} s",
}
DEMANDS = {
    "roll": "° of roll",
    "pitch": "° of pitch",
    "yaw": "°/s of yaw rate",
    "all": "° of roll, ° of pitch and °/s of yaw rate",
}

BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")  # A key that TOML needs no quotes around

MINIMUM_WORDS = {"minimum": "from", "exclusiveMinimum": "more than"}
MAXIMUM_WORDS = {"maximum": "to", "exclusiveMaximum": "to less than"}  # words for JSON schema's limits


def in_words(scenario: Scenario) -> list[str]:
    """A scenario in sentences, without its sensors, which are in ``in_toml``."""
    vehicle, stream = scenario.vehicle, scenario.stream
    sentences = [scenario.description] if scenario.description else []
    sentences += [
        f"Vehicle: {', '.join(_vehicle(vehicle))}.",
        ("Flight: " if scenario.flights == 1 else f"{scenario.flights} flights, each ")
        + f"{scenario.duration:g} s from arming to disarming, hovering at {scenario.height:g} m.",
        f"Seed: {scenario.seed}.",
        f"Wind: {_listed([_wind(one) for one in scenario.wind])}.",
    ]
    if scenario.moments:
        moments = [f"{one.sd:g} N m about {one.axis}, its kernel {one.s:g} s" for one in scenario.moments]
        sentences.append(f"Moments: {_listed(moments)}.")
    if scenario.excitation is not None:
        values = scenario.excitation.model_dump()
        values["demand"] = DEMANDS.get(values.get("axis", ""), "")
        sentences.append(f"Excitation: {EXCITATIONS[scenario.excitation.kind].format(**values)}.")
    sentences.append(
        f"Sends MAVLink {stream.version} as {AUTOPILOTS[stream.autopilot]}, system {stream.system}: attitude and motor "
        f"outputs at {stream.rate:g} Hz"
        + "".join(f", {name} at {rate:g} Hz" for name, rate in stream.rates.items())
        + ("; all but HEARTBEAT only when asked for." if stream.only_when_asked else ".")
    )
    return sentences + _damage(scenario) + _faults(scenario)


def _vehicle(vehicle: VehicleSpec) -> Iterator[str]:
    yield VEHICLES[vehicle.model]
    yield f"{FRAMES[vehicle.frame]} frame"
    if vehicle.battery_sag:
        yield f"its battery losing {vehicle.battery_sag:.0%}"
    if vehicle.battery_load:
        yield f"its battery giving {vehicle.battery_load:.1%} less in hover"
    if not vehicle.rotor_drag:
        yield "without rotor drag"
    if vehicle.quadratic_thrust is not None:
        yield f"its thrust {vehicle.quadratic_thrust:.0%} quadratic in the command and the rest linear"
    if vehicle.lag_up is not None:
        yield f"its rotors speeding up in {vehicle.lag_up:g} s"
    if vehicle.lag_down is not None:
        yield f"its rotors slowing down in {vehicle.lag_down:g} s"
    if vehicle.inertia_scale != 1:
        yield f"{vehicle.inertia_scale:g} times its inertia"
    if vehicle.weak_motor:
        yield f"motor {vehicle.weak_motor} with {vehicle.weak_thrust:.0%} of its thrust from {vehicle.weak_from:g} s on"


def _wind(wind: Wind) -> str:
    values = wind.model_dump()
    if isinstance(wind, Gust):
        values["stays"] = "for good" if wind.hold is None else f"for {wind.hold:g} s"
    return WINDS[wind.kind].format(**values)


def _damage(scenario: Scenario) -> list[str]:
    propeller, load, sentences = scenario.propeller, scenario.load, []
    if propeller.motor:
        left = f"{propeller.thrust:.0%} of its thrust and {propeller.torque:.0%} of its torque"
        sentences.append(
            f"The propeller of motor {propeller.motor} chips {propeller.start:g} s after arming: {left} are left, and "
            f"{propeller.unbalance:g} g mm are out of balance."
        )
    if load.forward or load.right:
        moves = [(load.forward, "forward", "back"), (load.right, "to the right", "to the left")]
        far = " and ".join(f"{abs(mm):g} mm {plus if mm > 0 else minus}" for mm, plus, minus in moves if mm)
        sentences.append(f"The load shifts {load.start:g} s after arming, and the centre of mass with it by {far}.")
    return sentences


def _faults(scenario: Scenario) -> list[str]:
    faults = scenario.faults
    faulty = [
        (faults.loss, f"loses {faults.loss:.1%}"),
        (faults.delay or faults.jitter, f"delays by {faults.delay:g} to {faults.delay + faults.jitter:g} s"),
        (faults.reordered, f"swaps {faults.reordered:.1%}"),
    ]
    link = [text for value, text in faulty if value]
    sentences = [f"The link {_listed(link)}."] if link else []
    if faults.reboot is not None:
        sentences.append(f"The autopilot reboots {faults.reboot:g} s after arming.")
    if faults.outage is not None:
        sentences.append(f"The link is lost {faults.outage:g} s after arming, for {faults.outage_seconds:g} s.")
    if faults.clock_jump is not None:
        jump = f"jumps ahead by {faults.clock_jump_seconds:g} s"
        sentences.append(f"The boot clock {jump} {faults.clock_jump:g} s after arming.")
    if faults.mavproxy_rate:
        sentences.append(f"Another ground station sets all streams to {faults.mavproxy_rate:g} Hz every 15 s.")
    return sentences


def _listed(parts: list[str]) -> str:
    return "; ".join(parts) or "none"


def in_toml(scenario: Scenario) -> str:
    """A scenario file with every value, which read again is the same scenario."""
    return "\n".join(_lines(scenario))


def _lines(scenario: Scenario) -> Iterator[str]:
    sections = {key: value for key, value in scenario if isinstance(value, tuple | BaseModel) or key in KINDS}
    yield from _pairs(scenario, leaving_out=sections)
    for key, value in sections.items():
        if key in KINDS:
            yield from ["", f"# {'[[wind]]' if key == 'wind' else f'[{key}]'}: its kind is one of"]
            yield from (f"#   {kind}: {', '.join(_keys(model))}" for kind, model in KINDS[key].items())
        elif not value:
            yield from ["", f"# [[{key}]]: {', '.join(_keys(Moment))}"]
        several = isinstance(value, tuple)
        for one in value if several else [value] if value is not None else []:
            yield from ["", f"{f'[[{key}]]' if several else f'[{key}]'}  # {_meaning(one)}", *_pairs(one)]


def _pairs(section: BaseModel, leaving_out: Iterable[str] = ()) -> Iterator[str]:
    schema = type(section).model_json_schema(mode="validation")["properties"]
    for key, value in section.model_dump(mode="json", exclude=set(leaving_out)).items():
        comment = "; ".join(filter(None, [_sentence(schema[key].get("description", "")), _allowed(schema[key])]))
        behind = f"  # {comment}" if comment else ""
        yield f"{_key(key)} = {_value(value)}{behind}"


def _allowed(schema: dict[str, Any]) -> str:
    """The values that a key may have, by its JSON schema."""
    for inside in (*schema.get("anyOf", ())[:1], schema.get("additionalProperties")):
        if isinstance(inside, dict):
            return _allowed(inside)
    if "enum" in schema:
        return " or ".join(str(one) for one in schema["enum"])
    if schema.get("type") == "boolean":
        return "true or false"
    least = [f"{word} {schema[name]:.10g}" for name, word in MINIMUM_WORDS.items() if name in schema]
    most = [f"{word} {schema[name]:.10g}" for name, word in MAXIMUM_WORDS.items() if name in schema]
    return " ".join(least + most)


def _keys(model: type[BaseModel]) -> list[str]:
    return [key for key in model.model_fields if key != "kind"]


def _meaning(section: BaseModel) -> str:
    return _sentence((type(section).__doc__ or "").splitlines()[0])


def _sentence(text: str) -> str:
    return text.removesuffix(".")


def _key(key: str) -> str:
    return key if BARE_KEY.fullmatch(key) else _value(key)


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(key)} = {_value(one)}" for key, one in value.items()) + "}"
    if value is None:
        return "inf"  # the time that never comes
    # Of text, numbers and truth values JSON's forms are TOML's too, but for U+007F, which TOML wants escaped.
    return printable(json.dumps(value, ensure_ascii=False))
