"""The driver on every model of the family, and the strangers of nearly the same name."""

import numpy as np
import pytest

from instrument import TDS2014, WrongInstrument
from instrument.dialogue.identify import parse_identity
from instrument.simulated import SimulatedTDS2014, resource_manager
from instrument.simulated.panel.models import MODELS, find_model


@pytest.mark.parametrize("name", MODELS)
def test_the_driver_takes_records_of_every_model(name: str) -> None:
    simulated = SimulatedTDS2014({1: lambda times: np.sin(2 * np.pi * 1e3 * times)}, model=name, noise_levels=0.0)
    manager = resource_manager(scopes={"GPIB0::1::INSTR": simulated})
    with TDS2014("GPIB0::1::INSTR", resource_manager=manager) as scope:
        assert scope.identity.channel_count == simulated.model.channels
        scope.set_channel("CH1", probe=1, scale=0.5)
        scope.set_timebase(2.5e-4)
        record = scope.acquire("CH1")
        assert len(record) == 2500
        assert record.volts.max() == pytest.approx(1.0, abs=0.05)
        if name.startswith("TBS"):
            assert scope.identity.model == f"TBS {name[3:]}"
    manager.close()


@pytest.mark.parametrize("model", ["TBS 1072B-EDU", "TBS 1102", "tds 2004c"])
def test_models_of_the_family_are_known_by_name(model: str) -> None:
    assert parse_identity(f"TEKTRONIX,{model},C010203,CF:91.1CT FV:v4.06").model == model


@pytest.mark.parametrize("model", ["TBS 1102C", "TBS 2104", "TDS 3014B", "TBS1202B-XYZ", "MSO2014"])
def test_scopes_of_other_records_are_refused_by_name(model: str) -> None:
    with pytest.raises(WrongInstrument, match=model):
        parse_identity(f"TEKTRONIX,{model},C010203,CF:91.1CT FV:v1.0")


@pytest.mark.parametrize(
    "family", ["TDS1000", "TDS2000", "TDS2000B", "TDS2000C", "TPS2000", "TBS1000", "TBS1000B"]
)
def test_a_family_is_one_of_its_models(family: str) -> None:
    found = find_model(family).name
    assert found in MODELS and len(found) == len(family)
    assert (found[:4], found[7:]) == (family[:4], family[7:])


def test_an_unknown_model_is_told_the_nearest_names() -> None:
    with pytest.raises(ValueError, match=r"'TDS2012D'; choose one of TDS2012B, TDS2012C|TDS2012") as error:
        find_model("TDS2012D")
    assert "TPS" not in str(error.value)
    with pytest.raises(ValueError, match="TDS2014"):
        find_model("oscilloscope")
