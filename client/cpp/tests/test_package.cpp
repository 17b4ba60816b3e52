// What users copy: the README's blocks, the examples, and the package once it is installed.
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <regex>
#include <sstream>

#include "robot.hpp"
#include "support.hpp"
#include "waypost/v1/label.grpc.pb.h"

namespace {

using namespace support;
using namespace waypost;
namespace fs = std::filesystem;

const fs::path package = WAYPOST_REPOSITORY "/client/cpp";

std::string read(const fs::path& file) {
  std::ifstream in(file);
  EXPECT_TRUE(in) << file;
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

bool has_block(const std::string& page, const std::string& language, const std::string& code) {
  return page.find("```" + language + "\n" + code + "```\n") != std::string::npos;
}

// The lines of all blocks of a language, without their indentation.
std::vector<std::string> blocks(const std::string& page, const std::string& language) {
  std::vector<std::string> lines;
  std::istringstream in(page);
  bool inside = false;
  for (std::string line; std::getline(in, line);) {
    if (line.rfind("```", 0) == 0) {
      inside = line == "```" + language;
    } else if (const std::size_t begin = line.find_first_not_of(' '); inside && begin != std::string::npos) {
      lines.push_back(line.substr(begin));
    }
  }
  return lines;
}

std::size_t lines_of(const fs::path& file) {
  const std::string text = read(file);
  return static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
}

TEST(Package, TheReadmeShowsWhatIsBuilt) {
  const std::string page = read(package / "README.md");
  EXPECT_TRUE(has_block(page, "cpp", read(package / "examples/map_folder.cpp"))) << "another map_folder.cpp";
  EXPECT_TRUE(has_block(page, "cpp", read(package / "examples/navigate.cpp"))) << "another navigate.cpp";
  EXPECT_TRUE(has_block(page, "cmake", read(package / "tests/consumer/CMakeLists.txt"))) << "another CMakeLists.txt";
  EXPECT_LE(lines_of(package / "examples/map_folder.cpp"), 60U);
  EXPECT_LE(lines_of(package / "examples/navigate.cpp"), 60U);
}

TEST(Package, TheGuideShowsLinesOfTheExamples) {
  const std::string page = read(WAYPOST_REPOSITORY "/docs/guide/src/cpp.md");
  const std::string examples = read(package / "examples/map_folder.cpp") + read(package / "examples/navigate.cpp");
  const std::vector<std::string> shown = blocks(page, "cpp");
  EXPECT_GE(shown.size(), 5U);
  for (const std::string& line : shown) EXPECT_NE(examples.find(" " + line + "\n"), std::string::npos) << line;
  const std::string project = read(package / "tests/consumer/CMakeLists.txt");
  for (const std::string& line : blocks(page, "cmake")) EXPECT_NE(project.find(line + "\n"), std::string::npos) << line;
}

TEST(Package, TheVersionIsThatOfTheServer) {
  std::smatch cargo;
  std::smatch cmake;
  const std::string cargo_text = read(WAYPOST_REPOSITORY "/Cargo.toml");
  const std::string cmake_text = read(package / "CMakeLists.txt");
  ASSERT_TRUE(std::regex_search(cargo_text, cargo, std::regex("\nversion = \"([^\"]+)\"")));
  ASSERT_TRUE(std::regex_search(cmake_text, cmake, std::regex("project\\(Waypost VERSION ([0-9.]+)")));
  EXPECT_EQ(cargo[1], cmake[1]);
}

TEST(Package, AProgramIsBuiltWithWhatWasInstalled) {
  const TemporaryFolder folder;
  const std::string prefix = folder / "prefix";
  const Ran installed = run({WAYPOST_CMAKE, "--install", WAYPOST_BUILD, "--prefix", prefix});
  ASSERT_EQ(installed.code, 0) << installed.output;
  fs::create_directory(folder / "robot");
  fs::copy(package / "tests/consumer/CMakeLists.txt", folder / "robot");
  fs::copy(package / "examples/map_folder.cpp", folder / "robot");
  const Ran configured = run({WAYPOST_CMAKE, "-S", folder / "robot", "-B", folder / "build", "-DCMAKE_PREFIX_PATH=" + prefix});
  ASSERT_EQ(configured.code, 0) << configured.output;
  const Ran built = run({WAYPOST_CMAKE, "--build", folder / "build"});
  ASSERT_EQ(built.code, 0) << built.output;

  const Server server(folder / "data");
  const std::vector<std::string> settings = {"WAYPOST_SERVER=http://" + server.address()};
  fs::create_directory(folder / "images");
  for (std::size_t at = 0; at < 5; ++at) fs::copy(images()[at], folder / "images");
  const std::vector<std::string> command = {folder / "build" / "map_folder", folder / "images", "hall", "monday"};
  const Ran ran = run(command, settings);
  EXPECT_EQ(ran.code, 0) << ran.output;
  EXPECT_NE(ran.output.find(" places\n"), std::string::npos) << ran.output;
  // Called again, it has nothing to do.
  EXPECT_EQ(run(command, settings).output, ran.output);
  EXPECT_EQ(Client::connect(server.address()).map("hall").frames(), 5U);
  const Ran nobody = run(command, {"WAYPOST_SERVER=http://127.0.0.1:1"});
  EXPECT_EQ(nobody.code, 1);
  EXPECT_NE(nobody.output.find("check that waypost-server runs"), std::string::npos) << nobody.output;
}

TEST(Package, ItMayBeAFolderOfAnotherProject) {
  const TemporaryFolder folder;
  std::ofstream(folder / "CMakeLists.txt") << "cmake_minimum_required(VERSION 3.18)\nproject(robot CXX)\n"
                                           << "add_subdirectory(" << package << " waypost)\n"
                                           << "add_executable(robot robot.cpp)\n"
                                           << "target_link_libraries(robot PRIVATE Waypost::waypost)\n";
  std::ofstream(folder / "robot.cpp") << "int main() {}\n";
  const Ran configured = run({WAYPOST_CMAKE, "-S", folder / "", "-B", folder / "build"});
  EXPECT_EQ(configured.code, 0) << configured.output;
  const Ran targets = run({WAYPOST_CMAKE, "--build", folder / "build", "--target", "help"});
  EXPECT_NE(targets.output.find("waypost_contract"), std::string::npos) << targets.output;
  // Tests and examples are for those who work on the client itself.
  EXPECT_EQ(targets.output.find("map_folder"), std::string::npos) << targets.output;
}

TEST(Package, TheExampleLeadsARobot) {
  const TemporaryFolder folder;
  const Server server(folder / "data");
  const Client client = Client::connect(server.address());
  teach(client, "hall", 20);
  v1::SetLabelRequest request;
  request.set_place("maps/hall/places/4");
  request.set_label("dock");
  client.call(&v1::LabelService::Stub::SetLabel, request);
  const Ran ran = run({WAYPOST_NAVIGATE, "hall", "dock"}, {"WAYPOST_SERVER=" + server.address()});
  EXPECT_EQ(ran.code, 0) << ran.output;
  EXPECT_NE(ran.output.find("OUTCOME_FOUND"), std::string::npos) << ran.output;
  EXPECT_NE(ran.output.find("\narrived\n"), std::string::npos) << ran.output;
}

}  // namespace
