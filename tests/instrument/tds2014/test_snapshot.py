"""What measurement frameworks get of the driver: name, identity, all settings, events, an end."""

import json


def test_snapshot_is_json_and_all_settings(bench):
    snapshot = json.loads(json.dumps(bench.snapshot()))
    assert snapshot["name"] == bench.name == "TDS2014"
    assert snapshot["address"] == bench.resource_name
    parameters = snapshot["parameters"]
    assert parameters["CH1:SCALE"] == {"name": "CH1:SCALE", "value": 0.5, "unit": "V/div"}
    assert parameters["HORIZONTAL:MAIN:SCALE"]["value"] == 2.5e-4
    assert parameters["MATH:DEFINE"]["value"] == "CH1 - CH2"
    assert parameters["IDN"]["value"]["vendor"] == "TEKTRONIX"
    assert len(parameters) > 80
    bench.set_channel(1, scale=1.0)
    assert bench.snapshot(update=False)["parameters"]["CH1:SCALE"]["value"] == 0.5
    assert bench.snapshot()["parameters"]["CH1:SCALE"]["value"] == 1.0


def test_errors_and_shutdown(bench, bench_scope):
    assert bench.id == bench.identity.text
    assert bench.check_errors() == []
    for _ in bench_scope.execute(b"BANANA"):
        pass
    assert [event.code for event in bench.check_errors()] == [113]
    bench.shutdown()
    assert bench_scope.panel.number("CH1:PROBE") == 10
    bench.shutdown()
