// Digest of the sources from which the library is compiled (hatch_build.py).
#ifndef SOURCES
#define SOURCES ""
#endif

const char *sources(void) { return SOURCES; }
