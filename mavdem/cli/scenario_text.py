"""A scenario in words."""

from __future__ import annotations

from sitl_scenarios.scenario import Gust, Scenario, Wind

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
    "doublets": "the stick right and left by {amplitude:g}°, {width:g} s each, every {period:g} s",
    "chirp": "a sine of {amplitude:g}° from {lowest:g} to {highest:g} Hz every {period:g} s",
    "multisine": "sines of {sd:g}° together from {lowest:g} to {highest:g} Hz, again every {period:g} s",
    "steps": "{distance:g} m sideways and back every {period:g} s",
}


def in_words(scenario: Scenario) -> list[str]:
    """One sentence for each thing that there is to say, but for the sensors, which ``in_toml`` has."""
    vehicle, stream = scenario.vehicle, scenario.stream
    sentences = [scenario.description] if scenario.description else []
    sentences += [
        f"Vehicle: {VEHICLES[vehicle.model]}, {FRAMES[vehicle.frame]} frame"
        + (f", its battery losing {vehicle.battery_sag:.0%}" if vehicle.battery_sag else "")
        + ("." if vehicle.rotor_drag else ", without rotor drag."),
        f"Flight: {scenario.duration:g} s from arming to disarming, hovering at {scenario.height:g} m.",
        f"Seed: {scenario.seed}.",
        f"Wind: {_listed([_wind(one) for one in scenario.wind])}.",
    ]
    if scenario.moments:
        moments = [f"{one.sd:g} N m about {one.axis}, its kernel {one.s:g} s" for one in scenario.moments]
        sentences.append(f"Moments: {_listed(moments)}.")
    if scenario.excitation is not None:
        excitation = scenario.excitation
        sentences.append(f"Excitation: {EXCITATIONS[excitation.kind].format(**excitation.model_dump())}.")
    sentences.append(
        f"Speaks MAVLink {stream.version} as {AUTOPILOTS[stream.speaks]}, system {stream.system}: attitude and motor "
        f"outputs at {stream.rate:g} Hz"
        + "".join(f", {name} at {rate:g} Hz" for name, rate in stream.rates.items())
        + "."
    )
    return sentences + _faults(scenario)


def _wind(wind: Wind) -> str:
    values = wind.model_dump()
    if isinstance(wind, Gust):
        values["stays"] = "for good" if wind.hold is None else f"for {wind.hold:g} s"
    return WINDS[wind.kind].format(**values)


def _faults(scenario: Scenario) -> list[str]:
    faults = scenario.faults
    told = [
        (faults.loss, f"loses {faults.loss:.1%}"),
        (faults.delay or faults.jitter, f"delays by {faults.delay:g} to {faults.delay + faults.jitter:g} s"),
        (faults.reordered, f"swaps {faults.reordered:.1%}"),
    ]
    link = [text for value, text in told if value]
    sentences = [f"The link {_listed(link)}."] if link else []
    if faults.reboot is not None:
        sentences.append(f"The autopilot begins anew {faults.reboot:g} s after arming.")
    return sentences


def _listed(parts: list[str]) -> str:
    return "; ".join(parts) or "none"
