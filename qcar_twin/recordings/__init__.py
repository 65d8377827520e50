"""Recordings of a car: files in, streams of SI channels out, checked."""

from qcar_twin.recordings.channels import CHANNELS, Channel
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.recording import Recording, RecordingError, Stream

__all__ = ["CHANNELS", "Channel", "DataSet", "Recording", "RecordingError", "Stream", "write_dataset"]
