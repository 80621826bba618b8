// How the process holds the memory that it has freed.
#pragma once

namespace rg {

// For programs that compute: what matrices leave is kept for the next ones (256 MiB, and the heaps of
// threads), where glibc would give it back to the system at once and touch each page anew. For the whole
// process, before its threads.
void KeepFreedMemory();

}  // namespace rg
