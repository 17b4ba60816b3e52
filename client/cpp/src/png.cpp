// Pixels as PNG, so that no imaging library is needed.
#include <zlib.h>

#include <array>
#include <cstring>
#include <initializer_list>

#include "waypost/errors.hpp"
#include "waypost/frame.hpp"

namespace waypost {
namespace {

// PNG's names of its filter and colours.
constexpr char filter_up = 2;
constexpr char colour_grey = 0;
constexpr char colour_rgb = 2;
// A robot has little time, and its link is rarely that slow.
constexpr int compression_level = 1;

std::string big_endian(std::uint32_t number) {
  std::string bytes;
  for (const int shift : {24, 16, 8, 0}) bytes.push_back(static_cast<char>(number >> shift & 0xff));
  return bytes;
}

std::string chunk(const std::string& kind_and_body) {
  const auto* bytes = reinterpret_cast<const Bytef*>(kind_and_body.data());
  const uLong checksum = crc32(0, bytes, static_cast<uInt>(kind_and_body.size()));
  const auto body_bytes = static_cast<std::uint32_t>(kind_and_body.size() - 4);
  return big_endian(body_bytes) + kind_and_body + big_endian(static_cast<std::uint32_t>(checksum));
}

std::string packed(const std::string& bytes) {
  uLongf length = compressBound(static_cast<uLong>(bytes.size()));
  std::string out(length, '\0');
  const int result = compress2(reinterpret_cast<Bytef*>(out.data()), &length,
                               reinterpret_cast<const Bytef*>(bytes.data()), static_cast<uLong>(bytes.size()),
                               compression_level);
  if (result != Z_OK) throw Error("the pixels could not be packed: there is too little memory");
  out.resize(length);
  return out;
}

std::size_t channels_of(PixelFormat format) { return format == PixelFormat::grey ? 1 : 3; }

// Each row as its difference to the one above, which packs better.
std::string filtered(const Pixels& pixels) {
  const std::size_t channels = channels_of(pixels.format);
  const std::size_t packed_row = channels * pixels.width_px;
  const std::size_t row_bytes = pixels.row_bytes == 0 ? packed_row : pixels.row_bytes;
  std::string out;
  out.reserve((packed_row + 1) * pixels.height_px);
  std::vector<std::uint8_t> above(packed_row, 0);
  std::vector<std::uint8_t> row(packed_row);
  for (std::size_t y = 0; y < pixels.height_px; ++y) {
    std::memcpy(row.data(), pixels.data + y * row_bytes, packed_row);
    if (pixels.format == PixelFormat::bgr) {
      for (std::size_t x = 0; x < packed_row; x += channels) std::swap(row[x], row[x + 2]);
    }
    out.push_back(filter_up);
    for (std::size_t x = 0; x < packed_row; ++x) out.push_back(static_cast<char>(row[x] - above[x]));
    std::swap(above, row);
  }
  return out;
}

}  // namespace

Image Image::of_pixels(const Pixels& pixels) {
  const std::size_t packed_row = channels_of(pixels.format) * pixels.width_px;
  if (pixels.data == nullptr || pixels.width_px == 0 || pixels.height_px == 0) {
    throw InvalidUse("an image needs pixels: its data, width and height are empty");
  }
  if (pixels.row_bytes != 0 && pixels.row_bytes < packed_row) {
    throw InvalidUse("row_bytes is less than a row of pixels; leave it 0 if rows follow each other without a gap");
  }
  const char colour = pixels.format == PixelFormat::grey ? colour_grey : colour_rgb;
  const std::string header = big_endian(pixels.width_px) + big_endian(pixels.height_px) +
                             std::string{8, colour, 0, 0, 0};
  return Image("\x89PNG\r\n\x1a\n" + chunk("IHDR" + header) + chunk("IDAT" + packed(filtered(pixels))) +
               chunk("IEND"));
}

}  // namespace waypost
