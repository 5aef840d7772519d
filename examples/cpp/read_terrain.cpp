// Reads a lossless payload of `<robot>/perception/v1/terrain` with the ROS 2 message package guara_msgs (ros/guara_msgs), and
// prints what it contains and what is known about a position: read_terrain PAYLOAD X Y [STATUS]. Any Zenoh client may have
// received the payload. Given the node's status, queried after the payload arrived, it also prints if the grid may be used.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <map>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <guara_msgs/msg/terrain.hpp>
#include <rmw/rmw.h>
#include <rmw/serialized_message.h>
#include <rosidl_typesupport_cpp/message_type_support.hpp>

using diagnostic_msgs::msg::DiagnosticArray;
using guara_msgs::msg::Terrain;
using guara_msgs::msg::TerrainLayer;

// Flags of `hazard` of an unknown cell; all other flags are hazards of known ground.
constexpr unsigned UNKNOWN = 0x003f;

template<typename Message>
Message read_message(const char * name)
{
  std::ifstream file(name, std::ios::binary);
  std::vector<unsigned char> payload(std::istreambuf_iterator<char>(file), {});
  rmw_serialized_message_t bytes = rmw_get_zero_initialized_serialized_message();
  bytes.buffer = payload.data();
  bytes.buffer_length = bytes.buffer_capacity = payload.size();
  Message message;
  const auto * support = rosidl_typesupport_cpp::get_message_type_support_handle<Message>();
  if (rmw_deserialize(&bytes, support, &message) != RMW_RET_OK) {
    throw std::runtime_error(std::string(name) + ": these bytes are no " +
            (std::is_same<Message, Terrain>::value ? "Terrain message" : "status"));
  }
  return message;
}

// Field of the metadata, which is the text of a JSON object; strings are returned with their quotes.
std::string said(const std::string & metadata, const std::string & name)
{
  const std::string key = "\"" + name + "\": ";
  const std::size_t start = metadata.find(key);
  if (start == std::string::npos) {
    return "";
  }
  const std::size_t from = start + key.size();
  const std::size_t end = metadata[from] == '"' ? metadata.find('"', from + 1) + 1 : metadata.find_first_of(",}", from);
  return metadata.substr(from, end - from);
}

// Reasons why a grid may not be used, from the node's status queried after the grid arrived; empty if it may be used.
// If the node does not answer, no grid may be used.
std::string stale_because(const Terrain & terrain, const DiagnosticArray & status)
{
  std::map<std::string, std::string> now;
  for (const auto & item : status.status) {
    for (const auto & value : item.name == "transport" ? item.values : decltype(item.values){}) {
      now[value.key] = value.value;
    }
  }
  const auto quoted = [&now](const char * name) {return "\"" + now[name] + "\"";};
  const auto number = [&now](const char * name) {return std::atof(now[name].c_str());};
  if (said(terrain.metadata, "withdrawn") == "true") {
    return "it was withdrawn";
  }
  if (said(terrain.metadata, "run") != quoted("run")) {
    return "it is of a run of the node that is over";
  }
  const double age = number("clock_s") - std::atof(said(terrain.metadata, "scan_end_clock").c_str());
  if (!(age <= terrain.valid_for)) {
    return "it is too old";
  }
  const std::string epoch = said(terrain.metadata, "epoch");
  if ((epoch.empty() ? "\"\"" : epoch) != quoted("epoch")) {
    return "it is of another walk";
  }
  const double pauses = now["step"].empty() ? 0.0 : number("step") - static_cast<double>(terrain.step);
  if (pauses > terrain.valid_pauses) {
    return "its pauses are over";
  }
  if (said(terrain.metadata, "provisional") == "true" && (pauses > 0 || now["standing"] == "false")) {
    return "its pause is over and did not confirm it";
  }
  const bool is_overtaken = number("last_scan_sequence") > static_cast<double>(terrain.sequence);
  return is_overtaken && terrain.extent == "footprint" && !now["standing"].empty() ?
         "a newer one has been published" : "";
}

const TerrainLayer & layer(const Terrain & terrain, const std::string & name)
{
  for (const auto & each : terrain.layers) {
    const std::size_t count = each.float32_values.size() + each.uint16_values.size() + each.uint8_values.size();
    if (each.name == name && count == std::size_t{terrain.nx} * terrain.ny) {
      return each;
    }
  }
  throw std::runtime_error("no whole layer " + name);
}

int main(int count, char ** words)
{
  if (count != 4 && count != 5) {
    std::fprintf(stderr, "read_terrain PAYLOAD X Y [STATUS]\n");
    return 2;
  }
  try {
    const auto terrain = read_message<Terrain>(words[1]);
    if (terrain.version_major != Terrain::VERSION_MAJOR) {
      throw std::runtime_error("a Terrain message of another major version");
    }
    const std::string because = count == 5 ? stale_because(terrain, read_message<DiagnosticArray>(words[4])) : "";
    const auto & hazard = layer(terrain, "hazard").uint16_values;
    const auto & elevation = layer(terrain, "elevation").float32_values;
    const auto & score = layer(terrain, "traversability").float32_values;
    const std::size_t cells = std::size_t{terrain.nx} * terrain.ny;
    if (hazard.size() != cells || elevation.size() != cells || score.size() != cells) {
      throw std::runtime_error("a layer of another type than it should have");
    }
    unsigned safe = 0;
    for (const auto flags : hazard) {
      safe += flags == 0;
    }
    std::printf("%s, %s of step %lld: %u x %u cells, %u safe\n", terrain.robot.c_str(), terrain.extent.c_str(),
      static_cast<long long>(terrain.step), terrain.nx, terrain.ny, safe);
    // A point on the border of two cells belongs to the farther one; the margin protects against rounding errors.
    const double ix = std::floor((std::atof(words[2]) - terrain.origin_x) / terrain.resolution + 1e-6);
    const double iy = std::floor((std::atof(words[3]) - terrain.origin_y) / terrain.resolution + 1e-6);
    if (!(ix >= 0 && ix < terrain.nx && iy >= 0 && iy < terrain.ny)) {
      std::puts("off the grid: nothing is known");
      return 0;
    }
    const std::size_t at = static_cast<std::size_t>(iy) * terrain.nx + static_cast<std::size_t>(ix);
    std::printf("%s, %s, hazard %u, elevation %.6f, traversability %.6f\n",
      (hazard[at] & UNKNOWN) == 0 ? "known" : "unknown",
      hazard[at] == 0 && score[at] > 0 && because.empty() ? "safe" : "not safe",
      hazard[at], elevation[at], score[at]);
    if (count == 5) {
      std::puts(because.empty() ? "may be used" : ("not to step by: " + because).c_str());
    }
  } catch (const std::exception & error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
