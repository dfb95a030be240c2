#include <cstdlib>
#include <iostream>
#include <span>

#include <lz4.h>
#include <png.h>
#include <snappy.h>
#include <zstd.h>

#include <iotcloud/bench/codec/contestant.h>
#include <iotcloud/drivers/depth/depth_codec.h>

namespace iotcloud::bench {

namespace {

namespace depth = drivers::depth;
constexpr std::size_t raw_bytes = depth::frame_pixels * sizeof(std::uint16_t);

void must(bool holds, const char* what) {
  if (holds) return;
  std::cerr << what << '\n';
  std::exit(1);
}

const char* chars(const void* data) {
  return static_cast<const char*>(data);
}
char* chars(void* data) {
  return static_cast<char*>(data);
}

class Ours : public Contestant {
 public:
  explicit Ours(depth::Codec codec) : encoder_(codec) {}
  void encode(const Frame& disparities, Bytes& out) override {
    const auto payload = encoder_.encode(depth::FrameView(disparities));
    out.assign(payload.begin(), payload.end());
  }
  void decode(const Bytes& bytes, Frame& out) override {
    must(decoder_.decode(bytes, depth::FrameSpan(out)) == depth::DecodeError::none, "our frame is refused");
  }
  bool gives_mm() const override { return true; }

 private:
  depth::DepthEncoder encoder_;
  depth::DepthDecoder decoder_;
};

class Snappy : public Contestant {
 public:
  void encode(const Frame& disparities, Bytes& out) override {
    out.resize(snappy::MaxCompressedLength(raw_bytes));
    std::size_t size = 0;
    snappy::RawCompress(chars(disparities.data()), raw_bytes, chars(out.data()), &size);
    out.resize(size);
  }
  void decode(const Bytes& bytes, Frame& out) override {
    must(snappy::RawUncompress(chars(bytes.data()), bytes.size(), chars(out.data())), "Snappy");
  }
};

class Lz4 : public Contestant {
 public:
  void encode(const Frame& disparities, Bytes& out) override {
    out.resize(LZ4_compressBound(raw_bytes));
    out.resize(
        LZ4_compress_default(chars(disparities.data()), chars(out.data()), raw_bytes, static_cast<int>(out.size())));
  }
  void decode(const Bytes& bytes, Frame& out) override {
    must(LZ4_decompress_safe(chars(bytes.data()), chars(out.data()), static_cast<int>(bytes.size()), raw_bytes) ==
             static_cast<int>(raw_bytes),
         "LZ4");
  }
};

/// Compresses the frame, or the difference of each pixel to the previous one.
class Zstd : public Contestant {
 public:
  explicit Zstd(bool differences) : differences_(differences), work_(depth::frame_pixels) {}
  ~Zstd() override {
    ZSTD_freeCCtx(compressor_);
    ZSTD_freeDCtx(decompressor_);
  }
  Zstd(const Zstd&) = delete;
  Zstd& operator=(const Zstd&) = delete;
  void encode(const Frame& disparities, Bytes& out) override {
    const std::uint16_t* from = disparities.data();
    if (differences_) {
      work_[0] = from[0];
      for (std::size_t i = 1; i < work_.size(); ++i) work_[i] = static_cast<std::uint16_t>(from[i] - from[i - 1]);
      from = work_.data();
    }
    out.resize(ZSTD_compressBound(raw_bytes));
    out.resize(ZSTD_compressCCtx(compressor_, out.data(), out.size(), from, raw_bytes, 1));
  }
  void decode(const Bytes& bytes, Frame& out) override {
    must(ZSTD_decompressDCtx(decompressor_, out.data(), raw_bytes, bytes.data(), bytes.size()) == raw_bytes, "zstd");
    if (!differences_) return;
    for (std::size_t i = 1; i < out.size(); ++i) out[i] = static_cast<std::uint16_t>(out[i] + out[i - 1]);
  }

 private:
  bool differences_;
  Frame work_;
  ZSTD_CCtx* compressor_ = ZSTD_createCCtx();
  ZSTD_DCtx* decompressor_ = ZSTD_createDCtx();
};

class Png : public Contestant {
 public:
  void encode(const Frame& disparities, Bytes& out) override {
    png_image image = empty();
    image.width = depth::frame_width;
    image.height = depth::frame_height;
    image.format = PNG_FORMAT_LINEAR_Y;  // 16 bits, unchanged
    png_alloc_size_t size = raw_bytes * 2;
    out.resize(size);
    must(png_image_write_to_memory(&image, out.data(), &size, 0, disparities.data(), 0, nullptr) != 0, "PNG");
    out.resize(size);
  }
  void decode(const Bytes& bytes, Frame& out) override {
    png_image image = empty();
    must(png_image_begin_read_from_memory(&image, bytes.data(), bytes.size()) != 0, "PNG");
    image.format = PNG_FORMAT_LINEAR_Y;
    must(png_image_finish_read(&image, nullptr, out.data(), 0, nullptr) != 0, "PNG");
  }

 private:
  static png_image empty() {
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    return image;
  }
};

}  // namespace

std::vector<Named> all_contestants() {
  std::vector<Named> all;
  for (const auto codec : {depth::Codec::reference, depth::Codec::compact, depth::Codec::lossless}) {
    all.push_back({std::string(depth::codec_names[static_cast<int>(codec)]), std::make_unique<Ours>(codec)});
  }
  all.push_back({"Snappy", std::make_unique<Snappy>()});
  all.push_back({"LZ4", std::make_unique<Lz4>()});
  all.push_back({"zstd -1", std::make_unique<Zstd>(false)});
  all.push_back({"delta + zstd -1", std::make_unique<Zstd>(true)});
  all.push_back({"16-bit PNG", std::make_unique<Png>()});
  all.push_back({"RVL", make_rvl()});
  all.push_back({"Mehrotra", make_mehrotra()});
  return all;
}

}  // namespace iotcloud::bench
