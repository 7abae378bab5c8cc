"""The files of a run as typed models, shared by everything that writes or reads them (docs/run-folder.md)."""
