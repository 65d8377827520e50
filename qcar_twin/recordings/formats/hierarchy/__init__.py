"""Files that hold values in groups, and groups in groups: recordings of sensors, each with its own clock, at times."""

READERS = {".h5": "hdf5.read_hdf5", ".hdf5": "hdf5.read_hdf5", ".hdf": "hdf5.read_hdf5"}
