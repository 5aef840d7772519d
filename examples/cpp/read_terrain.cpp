// Says what a lossless payload of `<robot>/perception/v1/terrain` holds, and what is known of a place, with the message package
// guara_msgs of ROS 2 (ros/guara_msgs): read_terrain PAYLOAD X Y. Whatever Zenoh client brings the payload, the reading is the same.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include <guara_msgs/msg/terrain.hpp>
#include <rmw/rmw.h>
#include <rmw/serialized_message.h>
#include <rosidl_typesupport_cpp/message_type_support.hpp>

using guara_msgs::msg::Terrain;
using guara_msgs::msg::TerrainLayer;

// Flags of `hazard` with which nothing is known of a cell; any other is a reason not to step there.
constexpr unsigned UNKNOWN = 0x00ff;

Terrain read_terrain(std::vector<unsigned char> & payload)
{
  rmw_serialized_message_t bytes = rmw_get_zero_initialized_serialized_message();
  bytes.buffer = payload.data();
  bytes.buffer_length = bytes.buffer_capacity = payload.size();
  Terrain terrain;
  const auto * support = rosidl_typesupport_cpp::get_message_type_support_handle<Terrain>();
  if (rmw_deserialize(&bytes, support, &terrain) != RMW_RET_OK) {
    throw std::runtime_error("these bytes are no Terrain message");
  }
  if (terrain.version_major != Terrain::VERSION_MAJOR) {
    throw std::runtime_error("a Terrain message of another major version");
  }
  return terrain;
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
  if (count != 4) {
    std::fprintf(stderr, "read_terrain PAYLOAD X Y\n");
    return 2;
  }
  try {
    std::ifstream file(words[1], std::ios::binary);
    std::vector<unsigned char> payload(std::istreambuf_iterator<char>(file), {});
    const Terrain terrain = read_terrain(payload);
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
    // On the border of two cells the one beyond counts, and rounding must not choose the other.
    const double ix = std::floor((std::atof(words[2]) - terrain.origin_x) / terrain.resolution + 1e-6);
    const double iy = std::floor((std::atof(words[3]) - terrain.origin_y) / terrain.resolution + 1e-6);
    if (!(ix >= 0 && ix < terrain.nx && iy >= 0 && iy < terrain.ny)) {
      std::puts("off the grid: nothing is known");
      return 0;
    }
    const std::size_t at = static_cast<std::size_t>(iy) * terrain.nx + static_cast<std::size_t>(ix);
    std::printf("%s, %s, hazard %u, elevation %.6f, traversability %.6f\n",
      (hazard[at] & UNKNOWN) == 0 ? "known" : "unknown", hazard[at] == 0 && score[at] > 0 ? "safe" : "not safe",
      hazard[at], elevation[at], score[at]);
  } catch (const std::exception & error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
