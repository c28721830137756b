"""Recordings: events with the stimulus that caused them, read from any camera's file."""

from pixelid.recordings.events import Events
from pixelid.recordings.reading import open_recording, open_recordings
from pixelid.recordings.recording import Recording
from pixelid.recordings.writing import write_recording

__all__ = ["Events", "Recording", "open_recording", "open_recordings", "write_recording"]
