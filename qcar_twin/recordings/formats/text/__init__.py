"""Tables written as text, by people and by tools: how they are written, what their heads say, and their samples."""

# the function's module first, so that whoever asks what is readable imports nothing
READERS = {
  ".csv": "samples.read_text",
  ".tsv": "samples.read_text",
  ".txt": "samples.read_text",
  ".log": "samples.read_text",
  ".dat": "samples.read_text",
  ".lvm": "samples.read_text",
  ".asc": "samples.read_text",
  ".tab": "samples.read_text",
  ".prn": "samples.read_text",
  ".vbo": "vbox.read_vbo",
  ".lp": "line_protocol.read_line_protocol",
}
