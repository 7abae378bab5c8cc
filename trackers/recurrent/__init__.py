"""Recurrent networks: the dilated ConvGRU and the Deep Tracking RNN."""
