"""Hand-written variants of the networks: the same function of the same parameters, computed faster.

A variant is a class that is made from a trained network, `Variant(network)`, and is a Recurrence: for inference an
InferenceNetwork, for training one with a gradient. Each module of a network has two tables of them: INFERENCE, by
precision, and TRAINING, by kind of device. One test compares all of them with their networks.

A variant is at least 1.15 times as fast as the fastest of PyTorch, `torch.compile` and ONNX Runtime
(`benchmarks/inference.py`, `benchmarks/recurrent.py`). The exception: training in float32 runs the code of bfloat16,
where it is that fast, and gains less than 1.15. It needs no compiler, as `torch.compile` does.
"""
