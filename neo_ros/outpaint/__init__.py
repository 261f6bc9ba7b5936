"""Networks, losses, the stream of training pairs, fitting and the ONNX export."""
