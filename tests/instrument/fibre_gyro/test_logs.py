"""Logs as other programs write them, and what is said about a bad one."""

import datetime
import gzip

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings, strategies as st
from log_text import parse_gyro_log

from instrument import FileFormatError
from instrument.fibre_gyro import Gap, Losses, Recording, read_gyro_log, write_gyro_log

PLAIN = "0.00,10,25.1\n0.01,11,25.2\n0.02,-12,25.3\n"


@pytest.mark.parametrize(
    "text",
    [
        PLAIN,
        "Time,Counts,Temperature\n" + PLAIN,
        "time_s,counts,temp\n" + PLAIN,
        "# FOG run 12\n% more\n\nTime [s],Counts (LSB),Temp (degC)\n" + PLAIN + "\n# end\n",
        PLAIN.replace(",", ";"),
        PLAIN.replace(",", "\t").replace("\n", "\r\n"),
        PLAIN.replace(",", "   "),
        PLAIN.replace(",", ";").replace(".", ","),
        "t;n;t_c\n" + PLAIN.replace(",", ";").replace(".", ",").replace("\n", ";\n"),
        "\ufefftime (ms),counts,temperature\n0,10,25.1\n10,11,25.2\n20,-12,25.3\n",
        "time,counts,temperature\n5e2,1e1,25.1\n500.01,+11,25.2\n500.02,-12.,25.3\n",
        '"time","counts","temperature"\n"0.00","10","25.1"\n"0.01","11","25.2"\n"0.02","-12","25.3"\n',
        "temperature,time,counts\n25.1,0,10\n25.2,0.01,11\n25.3,0.02,-12\n",
    ],
)
def test_same_log_in_many_spellings(text, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(text, "utf-8", newline="")
    log = read_gyro_log(path)
    assert log.counts.tolist() == [10, 11, -12]
    assert log.temperature.tolist() == [25.1, 25.2, 25.3]
    assert log.times == pytest.approx([0, 0.01, 0.02], abs=1e-9)
    assert log.interval_s == pytest.approx(0.01)
    assert log.complete and log.clock == "time column"


START = datetime.datetime(2026, 3, 30, 23, 59, 59, 980_000)  # midnight comes after the second row
MOMENTS = [START + datetime.timedelta(milliseconds=10 * n) for n in range(400)]
RATES = np.random.default_rng(33).normal(0.4, 0.2, 400)  # deg/s


def log_of(header, time_format, scale):
    """A log of RATES over midnight in the words of another program."""
    rows = (
        f"{moment.strftime(time_format)[:-3]},{rate * scale:.12g}"
        for moment, rate in zip(MOMENTS, RATES, strict=True)
    )
    return "\n".join([*header, *rows, ""])


@pytest.mark.parametrize(
    ("header", "time_format", "scale"),
    [
        (["timestamp,rate [mdps]"], "%Y-%m-%dT%H:%M:%S.%f", 1e3),
        (["date,time,gyro (mrad/s)"], "%Y-%m-%d,%H:%M:%S.%f", np.pi / 0.18),
        (["Date,Time,rate_dps"], "%m/%d/%Y,%H:%M:%S.%f", 1.0),
        (["Date,Time,rate_dps"], "%d/%m/%Y,%H:%M:%S.%f", 1.0),
        (["datum,time,output [µrad/s]"], "%d.%m.%Y,%H:%M:%S.%f", np.pi / 1.8e-4),
        (["time,delta_theta [rad]"], "%H:%M:%S.%f", np.pi / 180 * 0.01),
        (["Time,dtheta (degrees)"], "%Y/%m/%d %H:%M:%S.%f", 0.01),
        (["Time,angle_increment [arcsec]"], "%Y/%m/%d %H:%M:%S.%f", 36.0),
        (["time,rate", ",deg/h"], "%H:%M:%S.%f", 3600.0),
        (["Gyro 17", "time,rate", "(s),(mdeg/s)"], "%H:%M:%S.%f", 1e3),
        (["time,gyro"], "%H:%M:%S.%f", 5000.0),
    ],
)
@pytest.mark.parametrize("packed", ["plain", "gzip", "utf-16"])
def test_units_dates_and_midnight(header, time_format, scale, packed, tmp_path):
    text, path = log_of(header, time_format, scale), tmp_path / "log"
    coded = text.encode("utf-16" if packed == "utf-16" else "utf-8")
    path.write_bytes(gzip.compress(coded) if packed == "gzip" else coded)
    log = read_gyro_log(path, counts_per_dps=5000.0)
    assert log.counts == pytest.approx(5000 * RATES, rel=1e-9)
    assert log.times == pytest.approx(0.01 * np.arange(400), abs=1e-6)
    assert log.complete and log.interval_s == pytest.approx(0.01, rel=1e-6)


@pytest.mark.parametrize(
    ("unit", "of_zero", "of_kelvin"), [("K", 273.15, 1.0), ("degF", 32.0, 1.8), ("°C", 0.0, 1.0)]
)
def test_temperature_is_in_deg_c(unit, of_zero, of_kelvin):
    log = parse_gyro_log(
        f"time,counts,temp [{unit}]\n0,1,{of_zero + 25 * of_kelvin}\n1,2,{of_zero}\n2,1,{of_zero}\n"
    )
    assert log.temperature == pytest.approx([25, 0, 0], abs=1e-9)
    with pytest.raises(FileFormatError, match="must be degC, K or degF, not 'mv'"):
        parse_gyro_log("time,counts,temp [mV]\n0,1,2\n1,2,3\n")


def test_an_angle_since_the_begin_is_no_output():
    text = "time,gyro [deg]\n0,1\n1,2\n2,4\n"
    with pytest.raises(FileFormatError, match="angle since the output before, say so with"):
        parse_gyro_log(text, counts_per_dps=10.0)
    assert parse_gyro_log(text, counts_per_dps=10.0, units="deg").counts.tolist() == [10, 20, 40]


def test_empty_columns_and_a_cut_archive(tmp_path):
    log = parse_gyro_log("time,note,counts,temperature\n0,,1,\n1,,2,\n2,,1,\n")
    assert log.counts.tolist() == [1, 2, 1] and log.temperature is None and log.extra == {}
    path = tmp_path / "log.gz"
    path.write_bytes(gzip.compress(np.random.default_rng(1).bytes(9000).hex().encode())[:4000])
    with pytest.raises(FileFormatError, match="compressed and cannot be unpacked to its end"):
        read_gyro_log(path)


BAD = {
    "ERR": ("5.00,ERR", "line 502: the counts is 'ERR', no number"),
    "nan": ("5.00,nan", "line 502: the counts is 'nan', no number"),
    "NUL": ("\0\0\0", "line 502 has 1 columns where 2 (time, counts) are expected"),
    "torn": ("5.0", "line 502 has 1 columns"),
    "header again": ("time,counts", "line 502: the time is 'time', no number"),
    "doubled": ("4.99,499", "line 502: 4.99 s comes after 4.99 s"),
    "late": ("3.2,500", "line 502: 3.2 s comes after 4.99 s"),
}


@pytest.mark.parametrize("fault", BAD)
def test_bad_rows_are_left_out_by_name_where_that_is_wished(fault):
    row, said = BAD[fault]
    rows = [f"{n / 100:.2f},{n}" for n in range(1000)]
    rows[500] = row
    text = "\n".join(["time,counts", *rows, ""])
    with pytest.raises(FileFormatError) as caught:
        parse_gyro_log(text)
    assert said in str(caught.value) and "skip_bad_rows" in str(caught.value)
    log = parse_gyro_log(text, skip_bad_rows=1)
    assert log.counts.tolist() == [n for n in range(1000) if n != 500]
    assert log.times == pytest.approx([n / 100 for n in range(1000) if n != 500], abs=1e-9)
    assert (log.losses.good, log.losses.missing, log.losses.unusable) == (999, 1, 1)
    assert said in next(iter(log.losses.reasons))
    rows[700] = "7.00,ERR"
    with pytest.raises(FileFormatError, match=r"after 1 that were left out, line [57]02"):
        parse_gyro_log("\n".join(["time,counts", *rows, ""]), skip_bad_rows=1)


def test_a_clock_that_was_set_back_goes_on():
    stamps = np.where(np.arange(1000) < 600, 0.0, -0.37) + 0.01 * np.arange(1000)
    text = "".join(f"{stamp:.2f},{n}\n" for n, stamp in enumerate(stamps))
    with pytest.raises(FileFormatError, match=r"line 601: 5\.63 s comes after 5\.99 s"):
        parse_gyro_log(text)
    log = parse_gyro_log(text, skip_bad_rows=1)
    assert log.counts.tolist() == list(range(1000)) and log.complete
    assert log.times == pytest.approx(0.01 * np.arange(1000), abs=1e-6)
    assert list(log.losses.reasons) == ["line 601: 5.63 s comes after 5.99 s"]


def test_two_columns_and_more_than_three():
    log = parse_gyro_log("0,5\n1,6\n2,7\n")
    assert log.temperature is None and log.extra == {} and log.duration_s == 3.0
    log = parse_gyro_log("time,counts,normal_error,status\n0,5,1.5,3\n1,6,2.5,4\n")
    assert log.extra["normal_error"].tolist() == [1.5, 2.5]
    assert log.status.tolist() == [3, 4]
    log = parse_gyro_log("7,0,5\n8,1,6\n", columns=("", "time", "counts"))
    assert log.counts.tolist() == [5, 6]
    assert parse_gyro_log("1.0,3\n3.0,4\n", time_unit="min").times.tolist() == [0, 120]


def test_gaps_come_from_the_time_column():
    kept = [0, 1, 2, 6, 7, 9]
    text = "".join(f"{0.02 * n + 1e-4 * (n % 2)},{n}\n" for n in kept)
    log = parse_gyro_log(text)
    assert [(gap.after, gap.missing, gap.cause) for gap in log.gaps] == [
        (2, 3, "rows missing"),
        (4, 1, "rows missing"),
    ]
    assert log.gaps[0].start_s == pytest.approx(0.06, abs=3e-4)
    assert log.gaps[0].duration_s == pytest.approx(0.06, abs=3e-4)
    assert (log.losses.good, log.losses.missing) == (6, 4)
    assert "3 outputs missing" in log.gaps[0].describe()
    # With every second row missing only the caller can know.
    sparse = "".join(f"{n},{n}\n" for n in range(0, 20, 2))
    assert parse_gyro_log(sparse).complete
    assert parse_gyro_log(sparse, interval_s=1.0).losses.missing == 9


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not one row of numbers"),
        ("# nothing\n", "not one row of numbers"),
        ("time,counts\n", "a header, but not one row"),
        ("time,angle\n0,1\n1,2\n", "must be one column 'counts', but the columns are time, angle"),
        ("a,b\n0,1\n1,2\n", "must be one column 'counts', but the columns are a, b"),
        ("5\n6\n", "must be one column 'time', but the columns are counts"),
        ("0,1\n1,x\n2,3\n", "line 2: the counts is 'x', no number"),
        ("time,counts\n\n# c\n0,1\n1,nan\n2,3\n", "line 5: the counts is 'nan'"),
        ("0,1\n1,\n2,3\n", "line 2: the counts is '', no number"),
        ("0,1\n1\n2,3\n", "line 2 has 1 columns where 2"),
        ("0,1\n1,2,3\n2,3\n", "line 2 has 3 columns where 2"),
        ("0,1\n1,2\n1,3\n", "line 3: 1 s comes after 1 s; rows are doubled"),
        ("0,1\n2,2\n1,3\n", "line 3: 1 s comes after 2 s"),
        ("0,1\n", "one row alone does not tell the interval"),
        ("time [days],counts\n0,1\n1,2\n", "unit of time must be one of s, ms"),
        ("time,time,counts\n0,1,2\n1,2,3\n", "must be one column 'time'"),
    ],
)
def test_mistakes_are_named_with_their_line(text, said, tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(FileFormatError) as caught:
        read_gyro_log(path)
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_rows_that_come_too_often():
    text = "".join(f"{n * 0.5},1\n" for n in range(20))
    with pytest.raises(FileFormatError, match=r"line 2: the rows do not come every 1 s"):
        parse_gyro_log(text, interval_s=1.0)
    with pytest.raises(FileFormatError, match="must be positive, not 0 s"):
        parse_gyro_log(text, interval_s=0.0)


VALUES = st.floats(-1e9, 1e9) | st.integers(-(2**31), 2**31).map(float)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(VALUES, VALUES, st.integers(0, 255)), min_size=2, max_size=20), st.booleans())
@example([(0.0, 0.0, 0), (943719.0, 0.0, 0)], False)  # no word without its sign
def test_what_is_written_comes_back_exactly(tmp_path, rows, with_temperature):
    counts, extra, status = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    times = np.arange(len(rows)) * 0.005
    made = Recording(
        times=times,
        counts=counts,
        temperature=extra / 3 if with_temperature else None,
        status=status.astype(np.int64),
        extra={"normal_error": extra},
        gaps=(),
        losses=Losses(),
        interval_s=0.005,
        clock="counter",
    )
    write_gyro_log(tmp_path / "log.csv", made)
    back = read_gyro_log(tmp_path / "log.csv")
    assert np.array_equal(back.times, times) and np.array_equal(back.counts, counts)
    assert np.array_equal(back.extra["normal_error"], extra) and np.array_equal(back.status, made.status)
    if with_temperature:
        assert np.array_equal(back.temperature, made.temperature)
    else:
        assert back.temperature is None


@given(st.text(alphabet="0123456789.,;-+eE \t\n\"'#nainftimecous", max_size=200))
def test_random_text_gives_a_recording_or_one_clear_error(text):
    try:
        log = parse_gyro_log(text)
    except FileFormatError as error:
        assert "\n" not in str(error)
    else:
        assert len(log.times) == len(log.counts) > 1


def test_losses_in_words():
    assert Losses(good=10).describe() == "10 frames, none lost"
    losses = Losses(5, 3, 2, 1, 40, {"bad status": 1}) + Losses(5, 0, 1, 0, 2, {"bad status": 1, "no header": 1})
    assert losses == Losses(10, 3, 3, 1, 42, {"bad status": 2, "no header": 1})
    assert losses.describe() == "10 frames used, 3 missing, 3 damaged, 1 unusable (2 bad status, 1 no header)"
    assert Gap(4, 1.5, 0.01, 1, "frames lost").describe() == "frames lost: 1 output missing 1.5 s after the begin"


WILD = [
    ("time,counts\n0,1\n0.01,2\n1e30,3\n0.03,4\n", "line 5: 0.03 s comes after 1e+30 s"),
    ("time,counts\n0,1\n0.01,2\n1e30,3\n", "the time goes from 0 s to 1e+30 s: is it the right column?"),
    ("time,counts\n0,1\n0.01,2\n0.02,1\n9e6,3\n", "line 5: the time goes on by 9e+06 s at once"),
    ("time,counts,status\n0,1,2\n1,2,1e20\n", "line 3: the status is 1e+20"),
    ("counter,time,counts\n0,0,2\n1,0,1\n2,0,1\n", "line 3: 0 s comes after 0 s"),
    ("time,counts\n12:00:00,1\n25:99:99,2\n12:00:02,3\n", "line 3: the time is '25:99:99', no number"),
    ("time,counts\n12:00:00,1\n12:00:01,12:00:01\n", "line 3: the counts is '12:00:01', no number"),
    ("time,counts\n12:00:00,1\n1.5,2\n12:00:02,3\n", "line 3: the time is '1.5', no number"),
    ("time,counts\n0,1\n1_000,2\n3,4\n", "line 3: the time is '1_000', no number"),
    (
        "date,time,counts\n31.02.2026,12:00:00,1\n31.02.2026,12:00:01,2\n",
        "none that can be read: write 2026-03-31",
    ),
    ("date,counts\n2026-03-31,1\n2026-03-31,2\n", "must be one column 'time'"),
]


@pytest.mark.parametrize(("text", "said"), WILD)
def test_wild_stamps_take_neither_time_nor_memory(text, said):
    """A stamp of 9e6 s made 9e8 places; a pause in the first rows as many trials."""
    with pytest.raises(FileFormatError) as caught:
        parse_gyro_log(text)
    assert said in str(caught.value)


def test_one_wild_stamp_does_not_change_the_unit_of_the_others():
    rows = [f"{n / 100:.2f},{n}" for n in range(200)]
    rows[70] = "3e11,70"  # in ms this would be 1979
    log = parse_gyro_log("\n".join(["time,counts", *rows, ""]), skip_bad_rows=2)
    assert log.interval_s == pytest.approx(0.01, rel=1e-6) and log.counts.size >= 199


def test_rows_of_which_none_is_left():
    with pytest.raises(FileFormatError, match="no row can be read: line 2: the counts is 'x'"):
        parse_gyro_log("time,counts\n0,x\n1,y\n", skip_bad_rows=10)


def test_a_long_pause_among_the_first_rows_is_a_gap():
    stamps = np.concatenate([0.001 * np.arange(1500), 3000 + 0.001 * np.arange(60_000)])
    stamps += np.random.default_rng(5).uniform(0, 2e-4, stamps.size)
    log = parse_gyro_log("".join(f"{stamp:.6f},1\n" for stamp in stamps))
    assert log.interval_s == pytest.approx(0.001, rel=1e-4)
    assert log.losses.missing == pytest.approx(2_998_500, abs=100)
