// A fading memory over the wire protocol (docs/wire.md): each cell as last visible, with a weight that decays. No library.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <stdexcept>
#include <string>
#include <vector>

struct Message {
    std::string header;
    std::vector<uint8_t> body;

    // The number after the first "key": in the header. The referee writes compact JSON, and a quote inside a string
    // is escaped, so no string content can match. Use a JSON library for more than this.
    double number(const char *key) const {
        const auto position = header.find('"' + std::string(key) + "\":");
        if (position == std::string::npos) throw std::runtime_error("the request lacks a field");
        return std::stod(header.substr(position + std::strlen(key) + 3));
    }
    bool is(const char *type) const { return header.rfind("{\"type\":\"" + std::string(type) + '"', 0) == 0; }
};

#pragma pack(push, 1)
struct Prefix {  // 16 bytes; assumes a little-endian processor
    char magic[3];
    uint8_t version;
    uint32_t header_bytes;
    uint64_t body_bytes;
};
#pragma pack(pop)

bool receive(Message &message) {
    Prefix prefix;
    if (std::fread(&prefix, sizeof prefix, 1, stdin) != 1) return false;  // stdin closed: the trial is over
    if (std::memcmp(prefix.magic, "GTW", 3) != 0 || prefix.version != 1 || prefix.header_bytes > 1u << 20 ||
        prefix.body_bytes > 1u << 30)
        throw std::runtime_error("not a message of wire version 1");
    message.header.resize(prefix.header_bytes);
    message.body.resize(prefix.body_bytes);
    return std::fread(message.header.data(), 1, prefix.header_bytes, stdin) == prefix.header_bytes &&
           std::fread(message.body.data(), 1, prefix.body_bytes, stdin) == prefix.body_bytes;
}

void send(const Message &request, const char *type, const std::string &fields, const std::string &arrays = "",
          const std::vector<float> &body = {}) {
    const std::string header = "{\"type\":\"" + std::string(type) + "\",\"id\":" +
                               std::to_string(static_cast<long long>(request.number("id"))) + ",\"arrays\":[" + arrays +
                               "]," + fields + "}";
    const Prefix prefix{{'G', 'T', 'W'}, 1, static_cast<uint32_t>(header.size()), body.size() * sizeof(float)};
    std::fwrite(&prefix, sizeof prefix, 1, stdout);
    std::fwrite(header.data(), 1, header.size(), stdout);
    std::fwrite(body.data(), sizeof(float), body.size(), stdout);
    std::fflush(stdout);
}

struct FadingTracker {
    const double background = 0.02, half_life_s = 1.0;
    size_t size = 0, cells = 0;
    double period_s = 0.0;
    int64_t stamp_ns = 0;        // of the last frame, if there was one
    bool started = false;
    std::vector<double> excess;  // P(occupied) less the background, row by row

    double trust_after(double seconds) const { return std::pow(0.5, seconds / half_life_s); }

    void start(const Message &request) {
        size = static_cast<size_t>(request.number("size"));
        cells = size * size;
        period_s = request.number("period_s");
        reset();
    }

    void reset() {
        excess.assign(cells, 0.0);
        started = false;
    }

    // The stamp is the first array of the body; `visible` and `occupied` are the last two.
    void update(const Message &request) {
        if (request.body.size() < sizeof stamp_ns + 2 * cells) throw std::runtime_error("the frame is of another grid");
        const uint8_t *visible = request.body.data() + request.body.size() - 2 * cells, *occupied = visible + cells;
        int64_t now_ns;
        std::memcpy(&now_ns, request.body.data(), sizeof now_ns);
        const double trust = started ? trust_after(1e-9 * (now_ns - stamp_ns)) : 1.0;  // less over a gap
        stamp_ns = now_ns;
        started = true;
        for (size_t i = 0; i < cells; ++i) excess[i] = visible[i] ? occupied[i] - background : excess[i] * trust;
    }

    std::vector<float> predict(int steps) const {
        std::vector<float> occupancy;
        occupancy.reserve((steps + 1) * cells);
        for (int n = 0; n <= steps; ++n)
            for (const double e : excess)
                occupancy.push_back(static_cast<float>(background + trust_after(n * period_s) * e));
        return occupancy;
    }
};

int main() try {
    FadingTracker tracker;
    const std::string self = "\"api\":1,\"about\":\"Each cell as last seen, fading.\",\"classes\":[],"
                             "\"moving_sensor\":false,\"learns\":false,\"options\":{},\"options_schema\":{}";
    for (Message request; receive(request);) {
        const auto began = std::chrono::steady_clock::now();
        const auto cpu = std::clock();
        std::vector<float> forecast;
        if (request.is("describe") || request.is("start")) {
            if (request.header.find("\"options\":{}") == std::string::npos) {
                send(request, "error", "\"outcome\":\"not-applicable\",\"reason\":\"this tracker has no options\"");
                continue;
            }
            if (request.is("start")) tracker.start(request);
            send(request, request.is("start") ? "started" : "described", self);
            continue;
        }
        if (request.is("reset")) tracker.reset();
        if (request.is("update")) tracker.update(request);
        if (request.is("predict")) forecast = tracker.predict(static_cast<int>(request.number("steps")));
        const auto elapsed = std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now() - began);
        const std::string times = "\"elapsed_ns\":" + std::to_string(elapsed.count()) +
                                  ",\"cpu_ns\":" + std::to_string((std::clock() - cpu) * (1000000000 / CLOCKS_PER_SEC));
        const std::string m = std::to_string(tracker.size);
        const std::string shape = std::to_string(forecast.size() / std::max<size_t>(1, tracker.cells)) + "," + m + "," + m;
        if (request.is("predict"))
            send(request, "forecast", times,
                 "{\"name\":\"occupancy\",\"dtype\":\"float32\",\"shape\":[" + shape + "]}", forecast);
        else
            send(request, "done", times);
    }
} catch (const std::exception &error) {
    std::fprintf(stderr, "%s\n", error.what());  // stderr is the log; its last line becomes the reason
    return 1;
}
