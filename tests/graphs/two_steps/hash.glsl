// A 32-bit hash.
uint hash(uint x) {
    x ^= x >> 16;
    return x * 0x7feb352du;
}
