"""What an accelerometer's record shows: its largest forces in successive windows."""

import numpy as np
from numpy.testing import assert_array_equal
from partial_records import partial_record

from mavdem.witnesses.accelerometer import AccelerometerRecord


def test_the_largest_forces_are_of_whole_windows_that_have_samples():
    record = partial_record(
        AccelerometerRecord,
        time=np.array([0.5, 1.0, 1.4, 1.9, 4.2, 5.0, 5.9]),
        magnitude=np.array([99.0, 10.0, 12.0, 11.0, 15.0, 13.0, 98.0]),
    )
    assert_array_equal(record.window_peaks((1.0, 5.5), 1.0), [12.0, 15.0])
    assert len(record.window_peaks((5.0, 1.0), 1.0)) == 0
