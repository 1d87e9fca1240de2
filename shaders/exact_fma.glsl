// Computes a b + c, rounded once. The exact expression of depths needs this, as do compensated differences.
#if DEVICE_FUSED_FMA
#define exact_fma fma
#elif DEVICE_FLOAT64
// This device's fma() may round the product. In doubles the product is exact; the sum is rounded twice in one of 2^29 cases.
float exact_fma(float a, float b, float c) {
    precise double sum = double(a) * double(b) + double(c);
    return float(sum);
}
#else
// The product and the sum in floats, each with its rounding error (Dekker, Knuth). A factor is split into halves of 12 bits, whose
// products are exact. The result is rounded twice in one of 2^24 cases.
float exact_fma(float a, float b, float c) {
    float a_high = uintBitsToFloat(floatBitsToUint(a) & 0xfffff000u);
    float b_high = uintBitsToFloat(floatBitsToUint(b) & 0xfffff000u);
    precise float a_low = a - a_high;
    precise float b_low = b - b_high;
    precise float product = a * b;
    precise float product_rest = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low;
    precise float sum = product + c;
    precise float from_c = sum - product;
    precise float sum_rest = (product - (sum - from_c)) + (c - from_c);
    precise float result = sum + (sum_rest + product_rest);
    return result;
}
#endif
