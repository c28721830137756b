"""Data of a reconstruction: cameras, poses, events and views of a folder; published layouts; procedural scenes."""
