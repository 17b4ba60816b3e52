// Maps a folder of images, and prints where the robot was back at a place: map_folder FOLDER MAP SESSION
// The server's address, token and certificates come from WAYPOST_SERVER and such, as for the command line.
#include <algorithm>
#include <filesystem>
#include <iostream>
#include <vector>

#include "waypost/waypost.hpp"

namespace {

std::vector<std::filesystem::path> files_of(const char* folder) {
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  return files;
}

void print(const waypost::FrameOutcome& outcome) {
  if (const waypost::FrameRefused* refused = outcome.refusal()) {
    std::cout << "frame " << refused->sequence << " was refused: " << refused->error.what() << '\n';
    return;
  }
  const waypost::FrameAnswer& answer = outcome.answer();
  if (answer.reason() != waypost::v1::REASON_LOOP_CLOSURE) return;
  std::cout << "frame " << answer.sequence() << " is at place " << answer.place_number() << ", as frame "
            << answer.match().frame().sequence() << " was\n";
}

void map_folder(const char* folder, const char* map, const char* session_id) {
  const auto client = waypost::Client::connect();
  try {
    client.create_map(map);
  } catch (const waypost::AlreadyExists&) {
    // Then it grows.
  }
  waypost::SessionOptions options{map, session_id};
  options.on_outcome = print;
  waypost::Session session = client.open_session(options);
  // Called again, it goes on where it stopped.
  const std::uint64_t durable = session.last_committed_sequence().value_or(0);
  std::uint64_t sequence = 0;
  for (const auto& file : files_of(folder)) {
    if (++sequence <= durable) continue;
    const auto stamp_ns = static_cast<std::int64_t>(sequence) * 1'000'000'000;
    session.post({sequence, stamp_ns, waypost::Image::read(file), std::nullopt, file.filename().string()});
  }
  session.close();
  std::cout << client.map(map).places() << " places\n";
}

}  // namespace

int main(int count, char** arguments) try {
  if (count != 4) throw waypost::InvalidUse("usage: map_folder FOLDER MAP SESSION");
  map_folder(arguments[1], arguments[2], arguments[3]);
} catch (const std::exception& error) {
  std::cerr << error.what() << '\n';
  return 1;
}
