"""A unit tested by gyrolock as one phase of an OpenHTF test.

    python with_openhtf.py campaign.toml RLG-001

Every limit of the campaign becomes a measurement of the phase; the record of the test is attached. The phase
passes when the verdict is PASS: OpenHTF compares values alone, the station looks at their uncertainty too.
"""

import sys

import openhtf as htf
from openhtf.util import validators

import gyrolock


def gyro_phase(campaign, unit):
    """Return an OpenHTF phase that carries out a campaign of gyrolock."""
    station = gyrolock.Station(campaign, quiet=True)
    limits = station.limits(unit)
    measurements = [
        htf.Measurement(name).with_validator(validators.InRange(limit.at_least, limit.at_most))
        for name, limit in limits.items()
    ]

    @htf.measures(*measurements)
    def gyro(test):
        tested = station.test(test.test_record.dut_id)
        for name, one in tested.limits.items():
            if name in limits:
                test.measurements[name] = one.measured.value
        test.attach_from_file(str(tested.files.json), "gyrolock.json")
        test.attach_from_file(str(tested.files.page), "gyrolock.html")
        test.logger.info("%s %s", tested.verdict, tested.message)
        return htf.PhaseResult.CONTINUE if tested.verdict in ("PASS", None) else htf.PhaseResult.FAIL_AND_CONTINUE

    return gyro


if __name__ == "__main__":
    campaign, unit = sys.argv[1:]
    records = []
    test = htf.Test(gyro_phase(campaign, unit), test_name="ring laser gyro")
    test.add_output_callbacks(records.append)
    passed = test.execute(test_start=lambda: unit)
    for phase in records[0].phases:
        for name, measurement in phase.measurements.items():
            print(name, measurement.measured_value.value, measurement.outcome.name)
    print(records[0].outcome.name)
    sys.exit(0 if passed else 1)
