"""The driver in PyMeasure, QCoDeS and Bluesky: each used as its users do, on the simulated scope."""

import numpy as np
import pytest

from instrument.simulated import VirtualClock, resource_manager

NAME = "GPIB0::1::INSTR"


def sine(times):
    return 0.8 * np.sin(2 * np.pi * 1000.0 * times)


@pytest.fixture
def manager():
    made = resource_manager({1: sine, 2: lambda t: 0.5 * sine(t)}, noise_levels=0.0, clock=VirtualClock())
    yield made
    made.close()


@pytest.mark.filterwarnings("ignore::Warning")  # of the framework itself
def test_pymeasure_with_a_procedure_of_its_own(manager, tmp_path):
    pytest.importorskip("pymeasure")
    from pymeasure.experiment import FloatParameter, Procedure, Results, Worker

    from instrument.adapters.pymeasure_scope import PyMeasureScope

    scope = PyMeasureScope(NAME, resource_manager=manager)

    class PeakToPeak(Procedure):
        largest = FloatParameter("Largest scale", units="V", default=0.5)
        DATA_COLUMNS = ("Scale (V)", "Peak to peak (V)")

        def execute(self):
            for scale in (0.2, self.largest):
                scope.ch_1.scale = scale
                volts = scope.ch_1.acquire().volts
                self.emit("results", {"Scale (V)": scope.ch_1.scale, "Peak to peak (V)": np.ptp(volts)})

    scope.ch_1.probe = 1
    worker = Worker(Results(PeakToPeak(), str(tmp_path / "data.csv")))
    worker.start()
    worker.join(timeout=30)
    found = Results.load(str(tmp_path / "data.csv"), PeakToPeak).data
    assert found["Scale (V)"].tolist() == [0.2, 0.5]
    assert found["Peak to peak (V)"].tolist() == pytest.approx([1.6, 1.6], abs=0.05)
    assert scope.ask("CH1:COUPLING?").strip().endswith("DC")
    assert scope.ch_1.measure("FREQUENCY") == pytest.approx(1000, rel=0.02)
    assert scope.id.startswith("TEKTRONIX,TDS 2014") and len(scope.channels) == 4
    scope.shutdown()


@pytest.mark.filterwarnings("ignore::Warning")
def test_qcodes_with_a_real_database(manager, tmp_path):
    pytest.importorskip("qcodes")
    from qcodes.dataset import Measurement, initialise_or_create_database_at, load_or_create_experiment
    from qcodes.dataset.sqlite.database import conn_from_dbpath_or_conn

    from instrument.adapters.qcodes_scope import QCoDeSScope

    initialise_or_create_database_at(str(tmp_path / "runs.db"))
    experiment = load_or_create_experiment("beat", "gyro")
    scope = QCoDeSScope("scope", NAME, resource_manager=manager)
    try:
        scope.ch1.probe(1)
        scope.ch1.scale(0.5)
        scope.seconds_per_division(5e-4)
        scope.ch1.acquire()
        measurement = Measurement(exp=experiment)
        measurement.register_parameter(scope.ch1.record)
        with measurement.run(write_in_background=False) as saver:
            saver.add_result((scope.ch1.record, scope.ch1.record()))
        data = saver.dataset.get_parameter_data()["scope_ch1_record"]
        times, volts = data["scope_ch1_times"].ravel(), data["scope_ch1_record"].ravel()
        assert times.shape == volts.shape == (2500,)
        assert np.abs(volts - sine(times)).max() < 0.05
        assert scope.get_idn()["model"] == "TDS 2014"
        assert scope.snapshot(update=True)["submodules"]["ch1"]["parameters"]["scale"]["value"] == 0.5
        assert scope.ask("CH1:SCALE?").endswith("5.0E-1")
        saver.dataset.conn.close()
        conn_from_dbpath_or_conn(None, str(tmp_path / "runs.db")).close()
    finally:
        scope.close()


@pytest.mark.filterwarnings("ignore::Warning")
def test_bluesky_with_a_real_run_engine(manager):
    pytest.importorskip("ophyd_async")
    bluesky = pytest.importorskip("bluesky")
    from bluesky import plans

    from instrument.adapters.ophyd_scope import OphydScope

    scope = OphydScope(NAME, channels=("CH1", "CH2"), name="scope", resource_manager=manager)
    for channel in ("CH1", "CH2"):
        scope.driver.set_channel(channel, probe=1, scale=0.5)
    documents = []
    engine = bluesky.RunEngine({}, call_returns_result=True)
    result = engine(plans.count([scope], num=2), lambda name, document: documents.append((name, document)))
    assert result.exit_status == "success"
    (descriptor,) = [document for name, document in documents if name == "descriptor"]
    events = [document for name, document in documents if name == "event"]
    assert descriptor["data_keys"]["scope-CH1"]["shape"] == [2500]
    assert descriptor["configuration"]["scope"]["data"]["scope-CH1-scale"] == 0.5
    assert len(events) == 2
    for event in events:
        volts = np.asarray(event["data"]["scope-CH1"])
        interval = event["data"]["scope-CH1-sample_interval_s"]
        times = event["data"]["scope-CH1-first_sample_s"] + interval * np.arange(2500)
        assert np.abs(volts - sine(times)).max() < 0.05
        assert np.ptp(event["data"]["scope-CH2"]) == pytest.approx(0.8, abs=0.05)
    scope.close()
