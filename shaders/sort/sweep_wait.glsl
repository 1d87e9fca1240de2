    // Keys of earlier blocks in the same bin.
    uint next[BINS_PER_THREAD];
    uint before[BINS_PER_THREAD];
    [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
        next[j] = block;
        before[j] = 0u;
    }
    if (block == 0u) {
        lower_bins(before);
    }
    for (;;) {
        [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
            uint bin = thread * BINS_PER_THREAD + j;
            if (bin < BINS && !look_back(bin, next[j], before[j])) {
                atomicMax(stalled, next[j]);
            }
        }
        barrier();
        uint waited_for = stalled;
        barrier();
        if (waited_for == 0u) {
            break;
        }
        // It may never run: count its keys here.
        for (uint bin = thread; bin < BINS; bin += THREADS) {
            bin_place[bin] = 0u;
        }
        if (thread == 0u) {
            stalled = 0u;
        }
        barrier();
        uint other = (waited_for - 1u) * uint(BLOCK_KEYS);
        for (uint i = thread; i < uint(BLOCK_KEYS); i += THREADS) {
            atomicAdd(bin_place[digit_of(keys_in[other + i])], 1u);
        }
        barrier();
        uint lower[BINS_PER_THREAD];
        [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
            lower[j] = 0u;
        }
        if (waited_for == 1u) {
            lower_bins(lower);
        }
        [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
            uint bin = thread * BINS_PER_THREAD + j;
            if (bin < BINS) {
                uint word = ((lower[j] + bin_place[bin]) << 2) | (waited_for == 1u ? ALL_BEFORE : BLOCK_ALONE);
                atomicCompSwap(table[(waited_for - 1u) * BINS + bin], NOTHING, word);
            }
        }
        barrier();
    }
    [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
        uint bin = thread * BINS_PER_THREAD + j;
        if (bin < BINS) {
            publish(block, bin, ALL_BEFORE, before[j] + in_block[j]);
            bin_place[bin] = before[j] - starts[j];
        }
    }
    barrier();

