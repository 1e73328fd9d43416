"""Quality flags: what a record's estimate rests on, and what it cannot be trusted for."""

from enum import IntFlag


class Flag(IntFlag):
    """Bits of the `flags` field of an estimate. The lower-case name is the one used in JSON."""

    CLIPPED = 1
    DAMAGED = 2
    FEW_PERIODS = 4
    SECOND_HARMONIC_ABOVE_NYQUIST = 8
    HARMONICS_ALIASED = 16
    NO_BEAT = 32
    CONSTANT = 64
    MISFIT = 128
    RATE_WANDER = 256
    RATIO_NOT_SIGNIFICANT = 512
    COLOURED_NOISE = 1024
    TOO_FEW_SAMPLES = 2048
    NOT_LOCK_IN_LIKE = 4096
    ROUNDING_REPEATS = 8192
    AMPLITUDE_LOST = 16384
    PARTS_DIFFER = 32768
    FEW_LEVELS = 65536
    TABLE_MISMATCH = 1 << 20
    SCALE_FACTOR_MISMATCH = 1 << 21
    RATE_MISMATCH = 1 << 22
    BEAT_WANDERS = 1 << 23
    PHASE_TURNS = 1 << 24
    COPY = 1 << 25
    MAINS = 1 << 26
    MAINS_BESIDE = 1 << 27
    RECORDS_DIFFER = 1 << 28


FATAL = Flag.NO_BEAT | Flag.CONSTANT | Flag.TOO_FEW_SAMPLES | Flag.NOT_LOCK_IN_LIKE | Flag.COPY
"""With any of these no lock-in rate can be given; the estimate's fields are nan."""

DOUBTFUL = (
    Flag.MISFIT | Flag.AMPLITUDE_LOST | Flag.PARTS_DIFFER | Flag.FEW_PERIODS | Flag.FEW_LEVELS | Flag.RATE_MISMATCH
) | Flag.MAINS
"""With any of these the record was not what the estimate rests on: the number may be off by more than u."""

_SENTENCES = {
    Flag.CLIPPED: "Some samples stand at the end of the converter's range; they were left out of the fit.",
    Flag.DAMAGED: "Single spikes or missing samples were found; they were left out of the fit.",
    Flag.FEW_PERIODS: "Fewer than 3 periods of the beat are in the record: use a slower time base.",
    Flag.SECOND_HARMONIC_ABOVE_NYQUIST: "The second harmonic lies above half the sampling rate and is "
    "measured by its alias: use a faster time base.",
    Flag.HARMONICS_ALIASED: "A harmonic folds back so close to another that they cannot be told apart by "
    "frequency: change the time base or the rate.",
    Flag.NO_BEAT: "No significant beat: the signal does not stand out of the noise.",
    Flag.CONSTANT: "All samples are equal: nothing is connected, the channel is grounded or fully clipped.",
    Flag.MISFIT: "The record departs from the lock-in waveform by more than its noise: distortion, a second "
    "signal or a moving rate.",
    Flag.RATE_WANDER: "The rate moved during the record; its motion was fitted.",
    Flag.RATIO_NOT_SIGNIFICANT: "The second harmonic does not stand out of the noise: the interval begins at "
    "zero, the value itself means little.",
    Flag.COLOURED_NOISE: "The noise is not white; the uncertainty uses its strength at the harmonics.",
    Flag.TOO_FEW_SAMPLES: "Too few valid samples are left to fit the waveform.",
    Flag.NOT_LOCK_IN_LIKE: "The waveform is not that of a gyro above lock-in; a lock-in rate would mean nothing.",
    Flag.ROUNDING_REPEATS: "The sampling is locked to the beat and there is hardly any noise: a few rounding "
    "errors repeat over the whole record. Change the time base by one step.",
    Flag.AMPLITUDE_LOST: "The beat is weaker than it should be, or its amplitude differs between records: it was "
    "averaged over a phase that was not triggered, which spoils the ratio. Use SAMPLE mode.",
    Flag.PARTS_DIFFER: "Parts of the record show different lock-in rates, or no beat: something changed while it "
    "was taken (beam, rate, time base, vibration). The uncertainty holds the difference.",
    Flag.FEW_LEVELS: "The beat has the height of a few levels of the converter only: a gyro that swings inside "
    "lock-in looks like that. Use a finer vertical scale, and see that the gyro turns.",
    Flag.TABLE_MISMATCH: "Beat frequencies, harmonics and table rates do not fit together: a slow or AC-coupled "
    "channel or distortion changes the second harmonic, or scale factor, table rate or north are not as stated.",
    Flag.SCALE_FACTOR_MISMATCH: "The scale factor that an independent angle or the earth rate gives is not the "
    "one that was used; its error goes 1 : 1 into the lock-in rate.",
    Flag.RATE_MISMATCH: "The given rate is not the one that beat and second harmonic show: see that it is the "
    "rate on the gyro's axis, that the scale factor is right, and that a faster time base shows the same beat.",
    Flag.BEAT_WANDERS: "The beat moved by more than 0.2 % between records of one setting, and not as a known rate "
    "does. Look at the records one by one for a table that stopped, or a bench that was restarted.",
    Flag.RECORDS_DIFFER: "The lock-in rates of single records lie five times as far apart as noise explains. A "
    "mean of unlike records means little: look at each (--full), leave out those of another state (--exclude).",
    Flag.PHASE_TURNS: "The backscatter phase turned between the records: their sizes were averaged, not their "
    "complex values. Wait until mirrors and frame are warm, or take the records faster.",
    Flag.MAINS: "A beat at the frequency of the mains with next to no second harmonic: hum looks like that. Take "
    "a rate whose beat lies elsewhere, and see that the beat follows the rate.",
    Flag.MAINS_BESIDE: "A harmonic of the mains lies so close to the second harmonic of the beat that hum on it "
    "cannot be told from lock-in: change the rate a little, or take a longer record.",
    Flag.COPY: "The record is the copy of another one and was left out: name each record once.",
}


def flag_names(flags: int) -> list[str]:
    """Names of the bits that are set, as they stand in JSON.

    Examples
    --------
    >>> flag_names(Flag.CLIPPED | Flag.MISFIT)
    ['clipped', 'misfit']
    """
    return [str(f.name).lower() for f in Flag if f & int(flags)]


def describe_flag(name: str) -> str:
    """One sentence for the person who reads the result; `name` as given by `flag_names`."""
    return _SENTENCES[Flag[name.upper()]]
