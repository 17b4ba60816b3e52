// What a robot sends.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "waypost/v1/geometry.pb.h"
#include "waypost/v1/recognition.pb.h"

namespace waypost {

// Longer images are refused without being sent.
inline constexpr std::size_t max_image_bytes = std::size_t{4} << 20;

enum class PixelFormat {
  grey,
  rgb,
  // As OpenCV has them.
  bgr,
};

// Pixels of one byte a channel, row by row from the top; they are only looked at.
struct Pixels {
  const std::uint8_t* data = nullptr;
  std::uint32_t width_px = 0;
  std::uint32_t height_px = 0;
  PixelFormat format = PixelFormat::grey;
  // From one row to the next; 0 if rows follow each other without a gap.
  std::size_t row_bytes = 0;
};

// A JPEG or PNG, at most 4 MiB and 16 megapixels.
class Image {
 public:
  explicit Image(std::string jpeg_or_png) : bytes_(std::move(jpeg_or_png)) {}
  explicit Image(const std::vector<std::uint8_t>& jpeg_or_png) : bytes_(jpeg_or_png.begin(), jpeg_or_png.end()) {}
  // Reads a file. Throws InvalidUse if it cannot be read.
  static Image read(const std::filesystem::path& file);
  // Packs pixels as PNG, without loss; a JPEG of your own is smaller. Throws InvalidUse if there are none.
  static Image of_pixels(const Pixels& pixels);

  const std::string& bytes() const noexcept { return bytes_; }
  std::string take() && noexcept { return std::move(bytes_); }

 private:
  std::string bytes_;
};

// One frame: an image, or its words, for which the session has to be opened with `words_hash`.
struct Frame {
  // Rises within the session; gaps are allowed. At or below the last committed number it asks for the stored answer.
  std::uint64_t sequence = 0;
  // When the image was taken, by the robot's own steady clock: above 0, and rising.
  std::int64_t stamp_ns = 0;
  std::variant<Image, v1::WordHistogram, v1::WordList> content = Image(std::string());
  // Where the wheels say the robot is, in the session's odom frame; see `planar_odometry`.
  std::optional<v1::Odometry> odometry = std::nullopt;
  // What the robot calls the frame, as by the name of its file: at most 200 bytes without control characters. Told
  // back wherever the frame is named.
  std::string note = {};
};

// The odometry of a robot that drives on the floor: heading from x to the left.
v1::Odometry planar_odometry(double x_m, double y_m, double heading_rad);

}  // namespace waypost
