#include <algorithm>
#include <array>
#include <cctype>
#include <csetjmp>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>

#include <png.h>

#include <iotcloud/drivers/turtle/disparities.h>
#include <iotcloud/drivers/turtle/recording/images.h>

namespace iotcloud::drivers::turtle::recording {

namespace {

[[noreturn]] void refuse(const std::filesystem::path& file, const std::string& reason) {
  throw std::runtime_error(file.string() + ": " + reason);
}

void check_form(const std::filesystem::path& file, unsigned long width, unsigned long height, bool grey_16) {
  if (width != depth::frame_width || height != depth::frame_height) {
    refuse(file, "it has " + std::to_string(width) + "x" + std::to_string(height) +
                     " pixels; depth frames have 640x480, and are not resized (that would make up depths)");
  }
  if (!grey_16) refuse(file, "its pixels are not 16 bits of grey: it is a picture, not depth");
}

std::string lower_case(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

bool is_digit(char c) {
  return c >= '0' && c <= '9';
}

/// Compares names; numbers in them count by value.
bool natural_order(std::string_view a, std::string_view b) {
  const auto skip_zeros = [](std::string_view& text) {
    while (text.size() > 1 && text[0] == '0' && is_digit(text[1])) text.remove_prefix(1);
  };
  const auto digits = [](std::string_view text) {
    return static_cast<std::size_t>(std::find_if_not(text.begin(), text.end(), is_digit) - text.begin());
  };
  while (!a.empty() && !b.empty()) {
    if (is_digit(a[0]) && is_digit(b[0])) {
      skip_zeros(a);
      skip_zeros(b);
      const std::size_t in_a = digits(a), in_b = digits(b);
      if (in_a != in_b) return in_a < in_b;
    }
    if (a[0] != b[0]) return a[0] < b[0];
    a.remove_prefix(1);
    b.remove_prefix(1);
  }
  return a.size() < b.size();
}

/// Reads the next number of a PGM's head; comments go from # to the end of the line.
unsigned long head_number(const std::filesystem::path& path, std::istream& file) {
  for (int c = file.peek(); std::isspace(c) || c == '#'; c = file.peek()) {
    if (file.get() == '#') {
      while (file && file.get() != '\n') {
      }
    }
  }
  unsigned long number = 0;
  if (!(file >> number)) refuse(path, "its head is no PGM's");
  return number;
}

void read_pgm(const std::filesystem::path& path, std::vector<std::uint16_t>& values) {
  std::ifstream file(path, std::ios::binary);
  if (!file) refuse(path, "it cannot be read");
  std::array<char, 2> magic{};
  if (!file.read(magic.data(), magic.size()) || magic[0] != 'P' || magic[1] != '5') {
    refuse(path, "it is no binary PGM: it does not begin with P5");
  }
  const unsigned long width = head_number(path, file), height = head_number(path, file), most = head_number(path, file);
  check_form(path, width, height, most > 255 && most <= 65535);
  file.get();  // the one white space before the pixels
  const auto bytes = static_cast<std::streamsize>(values.size() * 2);
  if (!file.read(reinterpret_cast<char*>(values.data()), bytes)) refuse(path, "it is cut off");
  for (std::uint16_t& value : values) value = static_cast<std::uint16_t>(value >> 8 | value << 8);
}

/// libpng's state. It lives outside the functions that libpng may jump out of, and is freed after them.
struct PngReader {
  PngReader() : png(png_create_read_struct(PNG_LIBPNG_VER_STRING, this, &PngReader::failed, &PngReader::warned)) {
    if (png) info = png_create_info_struct(png);
  }
  ~PngReader() { png_destroy_read_struct(&png, &info, nullptr); }
  PngReader(const PngReader&) = delete;
  PngReader& operator=(const PngReader&) = delete;
  static void failed(png_structp png, png_const_charp text) {
    auto* self = static_cast<PngReader*>(png_get_error_ptr(png));
    std::snprintf(self->error.data(), self->error.size(), "%s", text);
    png_longjmp(png, 1);
  }
  static void warned(png_structp, png_const_charp) {}

  std::array<char, 128> error{};
  png_structp png = nullptr;
  png_infop info = nullptr;
};

/// \return false when libpng gave up. No object with a destructor may live here: libpng leaves by longjmp.
bool read_png_head(PngReader& reader, std::FILE* file) {
  if (setjmp(png_jmpbuf(reader.png))) return false;
  png_init_io(reader.png, file);
  png_read_info(reader.png, reader.info);
  return true;
}

bool read_png_rows(PngReader& reader, png_bytep* rows) {
  if (setjmp(png_jmpbuf(reader.png))) return false;
  png_set_swap(reader.png);  // its bytes come in big-endian order
  png_read_image(reader.png, rows);
  return true;
}

void read_png(const std::filesystem::path& path, std::vector<std::uint16_t>& values) {
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen(path.c_str(), "rb"), &std::fclose);
  if (!file) refuse(path, "it cannot be read");
  PngReader reader;
  if (!reader.png || !reader.info) throw std::bad_alloc();
  if (!read_png_head(reader, file.get())) refuse(path, std::string("it is no PNG (") + reader.error.data() + ")");
  check_form(path, png_get_image_width(reader.png, reader.info), png_get_image_height(reader.png, reader.info),
             png_get_color_type(reader.png, reader.info) == PNG_COLOR_TYPE_GRAY &&
                 png_get_bit_depth(reader.png, reader.info) == 16);
  std::vector<png_bytep> rows(depth::frame_height);
  for (std::size_t row = 0; row < rows.size(); ++row) {
    rows[row] = reinterpret_cast<png_bytep>(values.data() + row * depth::frame_width);
  }
  if (!read_png_rows(reader, rows.data())) refuse(path, std::string("it is damaged (") + reader.error.data() + ")");
}

bool is_png(const std::filesystem::path& file) {
  return lower_case(file.extension().string()) == ".png";
}

}  // namespace

std::vector<std::filesystem::path> find_images(const std::filesystem::path& folder) {
  std::error_code error;
  std::vector<std::filesystem::path> files;
  for (std::filesystem::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error)) {
    const std::string extension = lower_case(entry->path().extension().string());
    if (extension == ".pgm" || extension == ".png") files.push_back(entry->path());
  }
  if (error) throw std::runtime_error("cannot read the folder " + folder.string() + ": " + error.message());
  if (files.empty()) throw std::runtime_error("there is no .pgm and no .png in " + folder.string());
  std::sort(files.begin(), files.end(),
            [](const auto& a, const auto& b) { return natural_order(a.filename().string(), b.filename().string()); });
  return files;
}

void read_image(const std::filesystem::path& file, Unit unit, depth::FrameSpan disparities) {
  std::vector<std::uint16_t> values(depth::frame_pixels);
  if (is_png(file)) {
    read_png(file, values);
  } else {
    read_pgm(file, values);
  }
  if (unit == Unit::mm) {
    const auto& nearest = disparities_of_mm();
    for (std::uint16_t& value : values) value = nearest[value];
  } else if (const auto largest = *std::max_element(values.begin(), values.end()); largest > depth::no_reading) {
    refuse(file, "it has a value of " + std::to_string(largest) +
                     ", and disparities have 11 bits; if it is in millimetres say --unit mm");
  }
  std::copy(values.begin(), values.end(), disparities.begin());
}

}  // namespace iotcloud::drivers::turtle::recording
