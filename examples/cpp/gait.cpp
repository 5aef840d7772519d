// Gait controller in C++ with guara_msgs: gait STANCE.txt PAUSES SECONDS. The file has a line `JOINT ANGLE` for each joint
// and a line `FOOT NAME` for each supporting foot. The program announces stance pauses, streams the joints and reports the
// clock of their stamps. It prints messages as lines `KEY PAYLOAD` (hexadecimal), and answers each line `clock` on standard
// input with the current time. examples/relay_gait.py relays these lines; a gait with a Zenoh client needs no relay.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <limits>
#include <mutex>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>

#include <builtin_interfaces/msg/time.hpp>
#include <guara_msgs/msg/stance_pause.hpp>
#include <guara_msgs/msg/stance_stream.hpp>
#include <rmw/rmw.h>
#include <rmw/serialized_message.h>
#include <rosidl_typesupport_cpp/message_type_support.hpp>

using builtin_interfaces::msg::Time;
using guara_msgs::msg::StancePause;
using guara_msgs::msg::StanceStream;

// Sampling period of the joint stream, number of samples between two HOLDs, and noise of an encoder [rad].
constexpr auto SAMPLE_PERIOD = std::chrono::milliseconds(5);
constexpr int SAMPLES = 10;
constexpr double ENCODER_NOISE = 0.0002;
std::mutex output;

// Clock of the joints' stamps.
Time now()
{
  const auto since = std::chrono::system_clock::now().time_since_epoch();
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(since);
  Time time;
  time.sec = static_cast<std::int32_t>(seconds.count());
  time.nanosec = static_cast<std::uint32_t>(std::chrono::nanoseconds(since - seconds).count());
  return time;
}

template<typename Message>
void send(const char * key, const Message & message)
{
  rmw_serialized_message_t bytes = rmw_get_zero_initialized_serialized_message();
  const auto allocator = rcutils_get_default_allocator();
  if (rmw_serialized_message_init(&bytes, 0, &allocator) != RMW_RET_OK ||
    rmw_serialize(&message, rosidl_typesupport_cpp::get_message_type_support_handle<Message>(), &bytes) != RMW_RET_OK)
  {
    throw std::runtime_error(std::string(key) + ": this message cannot be written");
  }
  const std::lock_guard<std::mutex> lock(output);
  std::printf("%s ", key);
  for (std::size_t i = 0; i < bytes.buffer_length; ++i) {
    std::printf("%02x", bytes.buffer[i]);
  }
  std::printf("\n");
  std::fflush(stdout);
  if (rmw_serialized_message_fini(&bytes) != RMW_RET_OK) {
    throw std::runtime_error("memory of a message cannot be given back");
  }
}

int main(int count, char ** words)
{
  if (count != 4) {
    std::fprintf(stderr, "gait STANCE.txt PAUSES SECONDS\n");
    return 2;
  }
  StancePause pause;
  std::ifstream file(words[1]);
  for (std::string name, value; file >> name >> value; ) {
    if (name == "FOOT") {
      pause.stance.support_feet.push_back(value);
    } else {
      pause.stance.joint_names.push_back(name);
      pause.stance.joint_positions.push_back(std::atof(value.c_str()));
    }
  }
  const auto posture = pause.stance.joint_positions;
  std::mt19937_64 random{std::random_device{}()};
  std::normal_distribution<double> noise(0.0, ENCODER_NOISE);
  pause.robot = "guara";
  pause.header.frame_id = "base_footprint";
  pause.epoch = std::to_string(random());
  // Each message has new joint readings; here they are the posture with encoder noise.
  const auto say = [&](std::uint8_t phase, double time_available) {
      pause.header.stamp = now();
      pause.phase = phase;
      pause.time_available = time_available;
      for (std::size_t i = 0; i < posture.size(); ++i) {
        pause.stance.joint_positions[i] = posture[i] + noise(random);
      }
      send("guara/gait/v1/stance", pause);
    };
  StanceStream batch;
  batch.robot = pause.robot;
  batch.epoch = pause.epoch;
  batch.header.frame_id = "base_link";
  batch.joint_names = pause.stance.joint_names;
  batch.legs = pause.stance.support_feet;
  const auto stream = [&] {
      batch.times.clear();
      batch.joint_positions.clear();
      batch.supports.assign(SAMPLES * batch.legs.size(), 1);
      // Without an IMU, all values are NaN; the array must not be empty.
      batch.gravity_in_base.assign(3 * SAMPLES, std::numeric_limits<double>::quiet_NaN());
      batch.angular_velocity = batch.gravity_in_base;
      for (int k = 0; k < SAMPLES; ++k) {
        std::this_thread::sleep_for(SAMPLE_PERIOD);
        const Time time = now();
        if (k == 0) {
          batch.header.stamp = time;
        }
        const Time & first = batch.header.stamp;
        batch.times.push_back(
          time.sec - first.sec + 1e-9 * (static_cast<double>(time.nanosec) - static_cast<double>(first.nanosec)));
        for (const double angle : posture) {
          batch.joint_positions.push_back(angle + noise(random));
        }
      }
      send("guara/gait/v1/stance_stream", batch);
      ++batch.sequence;
    };
  std::thread([] {
      for (std::string line; std::getline(std::cin, line); ) {
        if (line == "clock") {
          send("guara/gait/v1/clock", now());
        }
      }
    }).detach();
  const double seconds = std::atof(words[3]);
  for (pause.step = 0; pause.step < std::atoi(words[2]); ++pause.step) {
    say(StancePause::BEGIN, seconds);
    const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
    while (std::chrono::steady_clock::now() < end) {
      stream();
      say(StancePause::HOLD, 0.0);
    }
    say(StancePause::END, 0.0);
    std::this_thread::sleep_for(std::chrono::seconds(1));
  }
  std::fflush(stdout);
  std::_Exit(0);
}
