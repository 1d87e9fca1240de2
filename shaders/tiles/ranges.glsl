// Writes each bin's range of the sorted pairs to the array `ranges` of the including file: its first pair and its end. The array is cleared
// before, so that bins without pairs have an empty range.

// Writes the bounds at a pair: if its bin differs from the previous pair's, its list starts and the previous list ends. Takes the bins
// of both pairs; pair `count` only ends the last list.
void find_ranges(uint pair, uint count, uint bin_before, uint bin) {
    const uint last = uint(BIN_COUNT) - 1u;
    bool is_first = pair == 0u;
    bool is_end = pair == count;
    if (!is_end && (is_first || bin_before != bin)) {
        ranges[min(bin, last)].x = pair;
    }
    if (!is_first && (is_end || bin_before != bin)) {
        ranges[min(bin_before, last)].y = pair;
    }
}
