#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <png.h>

#include <iotcloud/drivers/turtle/disparities.h>
#include <iotcloud/drivers/turtle/recording/images.h>
#include <iotcloud/tests/drivers/turtle/scratch_folder.h>

namespace iotcloud::drivers::turtle::recording {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

using Frame = std::vector<std::uint16_t>;

std::string big_endian(const Frame& values) {
  std::string bytes;
  for (const std::uint16_t value : values) {
    bytes += static_cast<char>(value >> 8);
    bytes += static_cast<char>(value & 255);
  }
  return bytes;
}

/// Each row of pixels counts from here; 0 and what is beyond the sensor's range are among them.
Frame millimetres() {
  Frame values(depth::frame_pixels);
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = static_cast<std::uint16_t>(i % 6000);
  return values;
}

void write_png(const std::string& path, const Frame& values, unsigned width, unsigned height, int depth_bits,
               int color) {
  std::FILE* file = std::fopen(path.c_str(), "wb");
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  png_infop info = png_create_info_struct(png);
  png_init_io(png, file);
  png_set_IHDR(png, info, width, height, depth_bits, color, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  png_write_info(png, info);
  png_set_swap(png);
  const std::size_t row_values = width * (color == PNG_COLOR_TYPE_RGB ? 3 : 1);
  const std::size_t stride = depth_bits == 16 ? row_values : row_values / 2;
  for (unsigned row = 0; row < height; ++row) {
    png_write_row(png, reinterpret_cast<png_const_bytep>(values.data() + row * stride));
  }
  png_write_end(png, info);
  png_destroy_write_struct(&png, &info);
  std::fclose(file);
}

std::string error_of(const std::string& file, Unit unit = Unit::mm) {
  Frame read(depth::frame_pixels);
  try {
    read_image(file, unit, depth::FrameSpan(read));
  } catch (const std::exception& e) {
    return e.what();
  }
  return "";
}

TEST(Disparities, of_millimetres_are_the_nearest) {
  const auto& table = disparities_of_mm();
  ASSERT_EQ(table.size(), 65536);
  EXPECT_EQ(table[0], depth::no_reading);
  EXPECT_EQ(table[304], depth::no_reading);
  EXPECT_EQ(depth::disparity_to_mm(table[305]), 305);
  EXPECT_EQ(table[4952], 1022);
  EXPECT_EQ(table[4953], depth::no_reading);
  EXPECT_EQ(table[65535], depth::no_reading);
  for (int mm = 305; mm <= 4952; ++mm) {
    const int miss = std::abs(depth::disparity_to_mm(table[static_cast<std::size_t>(mm)]) - mm);
    for (int d = 0; d <= 1022; ++d) ASSERT_LE(miss, std::abs(depth::disparity_to_mm(d) - mm)) << mm;
  }
}

TEST(Images, are_read_from_pgm_and_png_alike) {
  ScratchFolder folder("alike");
  folder.write("a.pgm", "P5\n# a comment\n640 480 # and another\n65535\n" + big_endian(millimetres()));
  write_png(folder.file("a.PNG"), millimetres(), 640, 480, 16, PNG_COLOR_TYPE_GRAY);
  Frame expected = millimetres();
  for (std::uint16_t& value : expected) value = disparities_of_mm()[value];
  Frame read(depth::frame_pixels);
  for (const char* name : {"a.pgm", "a.PNG"}) {
    std::fill(read.begin(), read.end(), 0);
    read_image(folder.file(name), Unit::mm, depth::FrameSpan(read));
    EXPECT_TRUE(read == expected) << name;
  }
}

TEST(Images, of_disparities_are_taken_as_they_are) {
  ScratchFolder folder("disparities");
  Frame values(depth::frame_pixels, 700);
  values[5] = 2047;
  folder.write("a.pgm", "P5 640 480 2047\n" + big_endian(values));
  Frame read(depth::frame_pixels);
  read_image(folder.file("a.pgm"), Unit::disparity, depth::FrameSpan(read));
  EXPECT_TRUE(read == values);
  values[5] = 2048;
  folder.write("b.pgm", "P5 640 480 65535\n" + big_endian(values));
  EXPECT_THAT(error_of(folder.file("b.pgm"), Unit::disparity), AllOf(HasSubstr("2048"), HasSubstr("--unit mm")));
}

TEST(Images, that_are_no_depth_frame_are_refused_with_the_reason) {
  ScratchFolder folder("refused");
  folder.write("small.pgm", "P5 320 240 65535\n" + std::string(153'600, 'x'));
  EXPECT_THAT(error_of(folder.file("small.pgm")), AllOf(HasSubstr("small.pgm"), HasSubstr("320x240")));
  folder.write("huge.pgm", "P5 4000000000 4000000000 65535\n");
  EXPECT_THAT(error_of(folder.file("huge.pgm")), HasSubstr("4000000000x4000000000"));
  folder.write("picture.pgm", "P5 640 480 255\n" + std::string(307'200, 'x'));
  EXPECT_THAT(error_of(folder.file("picture.pgm")), HasSubstr("16 bits"));
  folder.write("text.pgm", "P2 640 480 65535\n1 2 3");
  EXPECT_THAT(error_of(folder.file("text.pgm")), HasSubstr("P5"));
  folder.write("head.pgm", "P5 640 #");
  EXPECT_THAT(error_of(folder.file("head.pgm")), HasSubstr("head"));
  folder.write("cut.pgm", "P5 640 480 65535\n" + std::string(614'399, 'x'));
  EXPECT_THAT(error_of(folder.file("cut.pgm")), HasSubstr("cut off"));
  EXPECT_THAT(error_of(folder.file("absent.pgm")), HasSubstr("cannot be read"));

  write_png(folder.file("small.png"), millimetres(), 64, 48, 16, PNG_COLOR_TYPE_GRAY);
  EXPECT_THAT(error_of(folder.file("small.png")), HasSubstr("64x48"));
  write_png(folder.file("grey8.png"), millimetres(), 640, 480, 8, PNG_COLOR_TYPE_GRAY);
  EXPECT_THAT(error_of(folder.file("grey8.png")), HasSubstr("16 bits"));
  write_png(folder.file("colour.png"), Frame(depth::frame_pixels * 3), 640, 480, 16, PNG_COLOR_TYPE_RGB);
  EXPECT_THAT(error_of(folder.file("colour.png")), HasSubstr("16 bits"));
  folder.write("no.png", "certainly not");
  EXPECT_THAT(error_of(folder.file("no.png")), HasSubstr("no PNG"));
  write_png(folder.file("cut.png"), millimetres(), 640, 480, 16, PNG_COLOR_TYPE_GRAY);
  std::filesystem::resize_file(folder.file("cut.png"), 2000);
  EXPECT_THAT(error_of(folder.file("cut.png")), HasSubstr("damaged"));
}

TEST(Images, come_in_the_order_of_their_numbers) {
  ScratchFolder folder("order");
  for (const char* name : {"f10.pgm", "f9.png", "f009.PGM", "f2.pgm", "notes.txt", "f2b.pgm", "e.pgm"}) {
    folder.write(name, "");
  }
  std::vector<std::string> names;
  for (const auto& path : find_images(folder.path())) names.push_back(path.filename());
  ASSERT_EQ(names.size(), 6);
  EXPECT_EQ(names[0], "e.pgm");
  EXPECT_EQ(names[1], "f2.pgm");
  EXPECT_EQ(names[2], "f2b.pgm");
  EXPECT_EQ(names[5], "f10.pgm");
  EXPECT_ANY_THROW(find_images(folder.path() / "nothing"));
  std::filesystem::create_directory(folder.path() / "empty");
  EXPECT_ANY_THROW(find_images(folder.path() / "empty"));
}

}  // namespace
}  // namespace iotcloud::drivers::turtle::recording
