#include <algorithm>
#include <memory>

#include <lz4frame.h>
#include <zstd.h>

#include <iotcloud/recording/error.h>
#include <iotcloud/recording/mcap/compression.h>

namespace iotcloud::recording::mcap {

namespace {

constexpr std::size_t first_growth = 64 << 10;

/// Calls `step(out, room, in, size)` until the input is used up: it takes bytes of the input, fills room of the output,
/// sets both to what it took and wrote, and says whether the frame has ended.
template <typename Step>
std::string grow(std::string_view bytes, std::uint64_t size, const Step& step) {
  std::string out;
  std::size_t filled = 0;
  bool ended = false;
  while (!ended) {
    if (filled == out.size() && out.size() < size)
      out.resize(static_cast<std::size_t>(std::min<std::uint64_t>(size, std::max(first_growth, out.size() * 2))));
    char beyond = 0;  // takes a byte too many, should one come
    const bool full = filled == size;
    std::size_t room = full ? 1 : out.size() - filled, taken = bytes.size();
    ended = step(full ? &beyond : out.data() + filled, room, bytes.data(), taken);
    if (full && room > 0) throw RecordingError("a chunk has more than the " + std::to_string(size) + " bytes it says");
    filled += room;
    bytes.remove_prefix(taken);
    if (!ended && room == 0 && taken == 0) throw RecordingError("a chunk's compressed bytes end too early");
  }
  if (filled != size || !bytes.empty())
    throw RecordingError("a chunk has " + std::to_string(filled) + " bytes and says " + std::to_string(size));
  return out;
}

std::string from_lz4(std::string_view bytes, std::uint64_t size) {
  LZ4F_dctx* made = nullptr;
  if (LZ4F_isError(LZ4F_createDecompressionContext(&made, LZ4F_VERSION)) != 0) throw std::bad_alloc();
  const std::unique_ptr<LZ4F_dctx, LZ4F_errorCode_t (*)(LZ4F_dctx*)> context(made, LZ4F_freeDecompressionContext);
  return grow(bytes, size, [&](char* out, std::size_t& room, const char* in, std::size_t& taken) {
    const std::size_t hint = LZ4F_decompress(context.get(), out, &room, in, &taken, nullptr);
    if (LZ4F_isError(hint) != 0) throw RecordingError(std::string("a chunk is no LZ4: ") + LZ4F_getErrorName(hint));
    return hint == 0;
  });
}

std::string from_zstd(std::string_view bytes, std::uint64_t size) {
  const std::unique_ptr<ZSTD_DCtx, std::size_t (*)(ZSTD_DCtx*)> context(ZSTD_createDCtx(), ZSTD_freeDCtx);
  if (!context) throw std::bad_alloc();
  return grow(bytes, size, [&](char* out, std::size_t& room, const char* in, std::size_t& taken) {
    ZSTD_outBuffer to{out, room, 0};
    ZSTD_inBuffer from{in, taken, 0};
    const std::size_t hint = ZSTD_decompressStream(context.get(), &to, &from);
    if (ZSTD_isError(hint) != 0) throw RecordingError(std::string("a chunk is no zstd: ") + ZSTD_getErrorName(hint));
    room = to.pos;
    taken = from.pos;
    return hint == 0;
  });
}

}  // namespace

const char* word_of(Compression compression) {
  switch (compression) {
    case Compression::lz4:
      return "lz4";
    case Compression::zstd:
      return "zstd";
    case Compression::none:
      break;
  }
  return "";
}

Compression compression_of(std::string_view word) {
  for (const auto compression : {Compression::none, Compression::lz4, Compression::zstd}) {
    if (word == word_of(compression)) return compression;
  }
  throw RecordingError("a chunk is compressed by \"" + std::string(word.substr(0, 32)) +
                       "\"; lz4, zstd and none can be read");
}

std::string compress(Compression compression, std::string_view bytes) {
  std::string out;
  if (compression == Compression::lz4) {
    LZ4F_preferences_t preferences{};
    preferences.frameInfo.contentSize = bytes.size();
    out.resize(LZ4F_compressFrameBound(bytes.size(), &preferences));
    const std::size_t size = LZ4F_compressFrame(out.data(), out.size(), bytes.data(), bytes.size(), &preferences);
    if (LZ4F_isError(size) != 0) throw RecordingError(std::string("LZ4: ") + LZ4F_getErrorName(size));
    out.resize(size);
  } else if (compression == Compression::zstd) {
    out.resize(ZSTD_compressBound(bytes.size()));
    const std::size_t size = ZSTD_compress(out.data(), out.size(), bytes.data(), bytes.size(), 1);
    if (ZSTD_isError(size) != 0) throw RecordingError(std::string("zstd: ") + ZSTD_getErrorName(size));
    out.resize(size);
  } else {
    out = bytes;
  }
  return out;
}

std::string decompress(Compression compression, std::string_view bytes, std::uint64_t size) {
  if (compression == Compression::lz4) return from_lz4(bytes, size);
  if (compression == Compression::zstd) return from_zstd(bytes, size);
  if (bytes.size() != size)
    throw RecordingError("a chunk has " + std::to_string(bytes.size()) + " bytes and says " + std::to_string(size));
  return std::string(bytes);
}

}  // namespace iotcloud::recording::mcap
