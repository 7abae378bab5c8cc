"""Recurrent networks as trackers: the dilated ConvGRU and the original Deep Tracking RNN."""
