#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace iotcloud::recording::mcap {

/// How the records of a chunk are compressed. MCAP's words for them are "", "lz4" and "zstd".
enum class Compression { none, lz4, zstd };
/// MCAP's word for it.
const char* word_of(Compression compression);
/// What the word means. \throws RecordingError for another one.
Compression compression_of(std::string_view word);

/// Compresses whole bytes, as one frame.
std::string compress(Compression compression, std::string_view bytes);

/// The opposite. Memory grows with what really comes, never with what `size` only says.
/// \throws RecordingError unless exactly `size` bytes come of it.
std::string decompress(Compression compression, std::string_view bytes, std::uint64_t size);

}  // namespace iotcloud::recording::mcap
