// Writes each bin's range of the sorted pairs to the array `ranges` of the including file: its first pair and its end. The array is cleared
// before, so that bins without pairs have an empty range.

// A pair whose bin differs from the previous pair's starts the list of its bin and ends the previous list. Takes the bins of both
// pairs; pair `count` only ends the last list.
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
