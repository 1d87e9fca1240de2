// Maps floats to integers in the same order, for atomic minima and maxima.

uint in_order(float x) {
    uint bits = floatBitsToUint(x);
    return bits ^ ((bits >> 31) != 0u ? 0xffffffffu : 0x80000000u);
}

float from_order(uint x) {
    return uintBitsToFloat(x ^ ((x >> 31) != 0u ? 0x80000000u : 0xffffffffu));
}
