// The key of each pair before it is sorted.

// Maps a word by a bijection with random-looking results ("lowbias32" by C. Wellons).
uint mixed(uint x) {
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

uint key_of(uint value) {
    return mixed(value) >> (32 - KEY_BITS);
}
