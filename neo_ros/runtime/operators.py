"""The ONNX operators that a model file may use: what the export of our networks needs, no more."""

# All of the standard domain, all in the CPU, CUDA and TensorRT providers of the stock runtime.
ALLOWED_OPERATORS = frozenset({
    # shapes and copies
    'Cast', 'Concat', 'Constant', 'DepthToSpace', 'Expand', 'Flatten', 'Gather', 'Identity',
    'Pad', 'Reshape', 'Slice', 'SpaceToDepth', 'Split', 'Squeeze', 'Tile', 'Transpose',
    'Unsqueeze', 'Where',
    # arithmetic
    'Abs', 'Add', 'Clip', 'Div', 'Equal', 'Erf', 'Exp', 'Max', 'Min', 'Mul', 'Neg', 'Pow',
    'Reciprocal', 'ReduceMean', 'ReduceSum', 'ReduceL2', 'Round', 'Sqrt', 'Sub',
    # layers
    'AveragePool', 'BatchNormalization', 'Conv', 'ConvTranspose', 'Gelu', 'Gemm',
    'LayerNormalization', 'LeakyRelu', 'MatMul', 'Relu', 'Resize', 'Sigmoid', 'Softmax', 'Tanh',
    # int8
    'DequantizeLinear', 'QuantizeLinear',
})
