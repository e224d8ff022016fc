"""Section [estimator] of a controller file: a thermal observer, or an extended Kalman filter."""

from collections.abc import Callable
from typing import Any

from smajax import parameters
from smajax.control.controller_file.quantities import float_arrays, optional_quantity
from smajax.control.controller_file.renamed_keys import with_current_parameters
from smajax.control.controller_file.schema import EstimatorSection
from smajax.control.estimators.extended_kalman_filter import ExtendedKalmanFilter
from smajax.control.estimators.thermal_observer import ThermalObserver, UnstableObserverError
from smajax.control.loop.temperature_limiter import TemperatureLimiter
from smajax.control.sampled_plant import SampledPlant
from smajax.control.sensors.instruments import Instruments
from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.files.toml import quantity_at, show, validate
from smajax.units import as_text

_THERMAL_KEYS = ("a1", "a2", "exponent", "gain")
_EXTENDED_KEYS = ("unknown", "start", "temperature_process_noise", "fraction_process_noise", "use_estimate")


def read_estimator_section(data: Any, limiter: TemperatureLimiter | None) -> EstimatorSection:
    """Read the section, and check that something uses the estimator and that its keys belong to its kind.

    Args:
        data: The section of the file.
        limiter: The temperature limiter, if there is one.

    Raises:
        InputError: for a wrong key or value, or if nothing uses the estimator.
    """
    section = validate(EstimatorSection, data, "estimator")
    extended = section.kind == "extended"
    if limiter is None and not (extended and section.use_estimate):
        raise InputError(
            "[estimator] gives the wire's temperature to a temperature limiter, and there is none: add a section "
            "[temperature_limiter], or take [estimator] out"
            + (", or let the controller use it: use_estimate = true" if extended else "")
        )
    for key in _THERMAL_KEYS if extended else _EXTENDED_KEYS:
        if key in section.model_fields_set:
            other = "thermal" if extended else "extended"
            raise InputError(f'estimator.{key} belongs to kind = "{other}": take it out, or change the kind')
    return section


def build_extended_filter(
    section: EstimatorSection, rig: Rig, instruments: Instruments, period: float
) -> ExtendedKalmanFilter:
    """Build the extended Kalman filter on the rig's own plant; pulses of a carrier are replaced by their mean.

    Args:
        section: Section [estimator].
        rig: The rig.
        instruments: The instruments that the filter measures with.
        period: Period of the controller, s.

    Raises:
        InputError: for a wrong quantity, or an unknown parameter in ``estimator.unknown``.
    """
    deviations = {}
    for name, value in with_current_parameters(section.unknown, "estimator.unknown").items():
        try:
            declared = parameters.declaration(rig.plant, name)
        except InputError as error:
            raise InputError(f"estimator.unknown: {error}") from None
        unit = "K" if declared.unit == "degC" else declared.unit
        deviations[name] = quantity_at(value, unit, f"estimator.unknown.{name}", least=0.0)
    return ExtendedKalmanFilter.of(
        SampledPlant.of(rig.plant, period),
        instruments,
        deviations,
        initial_temperature_deviation=optional_quantity(section.start, "K", "estimator.start"),
        temperature_process_noise=optional_quantity(
            section.temperature_process_noise, "K", "estimator.temperature_process_noise"
        ),
        fraction_process_noise=optional_quantity(
            section.fraction_process_noise, "1", "estimator.fraction_process_noise"
        ),
    )


def build_thermal_observer(
    section: EstimatorSection, rig: Rig, limiter: TemperatureLimiter, period: float
) -> ThermalObserver:
    """Build the thermal observer; by default from the rig's convection and heat capacity at the limiter's limit.

    Args:
        section: Section [estimator].
        rig: The rig.
        limiter: The temperature limiter.
        period: Period of the controller, s.

    Raises:
        InputError: for a wrong or missing value, or one that is too fast for the period.
    """
    if (section.a1 is None) != (section.a2 is None):
        missing = "a1" if section.a1 is None else "a2"
        raise InputError(f"estimator.{missing} is missing: give both a1 and a2, or neither for those of the rig")
    gain = optional_quantity(section.gain, "1/s", "estimator.gain")
    if section.a1 is None:
        if section.exponent != 1:
            raise InputError(
                f"estimator.exponent = {show(section.exponent)} needs an a1 and an a2: give both, or take it out"
            )
        return _stable(lambda: ThermalObserver.of(rig.plant, float(limiter.limit), period, gain), limiter, section)
    a1 = quantity_at(section.a1, "K/J", "estimator.a1")
    if not a1 > 0.0:
        raise InputError(f"estimator.a1 = {show(section.a1)} would not heat a wire by its power: give one above 0")
    unit = "1/s" if section.exponent == 1 else f"K^{1 - section.exponent}/s"
    a2 = quantity_at(section.a2, unit, "estimator.a2")
    if not a2 < 0.0:
        raise InputError(f"estimator.a2 = {show(section.a2)} would heat the wire without power: give one below 0")
    ambient = float(rig.plant.environment.ambient)
    numbers = float_arrays(a1, a2, section.exponent, ambient, gain)
    return _stable(lambda: ThermalObserver(*numbers, period=period), limiter, section)


def _stable(
    build: Callable[[], ThermalObserver], limiter: TemperatureLimiter, section: EstimatorSection
) -> ThermalObserver:
    """The observer, if its explicit step is stable at the limiter's limit."""
    try:
        observer = build()
        observer.check_stability(limiter.limit)
    except UnstableObserverError as error:
        key = "gain" if error.gain_is_faster else "a2"
        value = getattr(section, key)
        cause = "the rig's heat loss in [estimator]" if value is None else f"estimator.{key} = {show(value)}"
        longest = as_text(error.longest_period, "s")
        raise InputError(
            f"{cause} acts faster than controller.period: give a smaller one, or a period of at most {longest}"
        ) from None
    return observer
