package interop;

import interop.original.TChannel;
import interop.original.TDirection;
import interop.original.TSensor;
import interop.original.TSensorState;
import java.nio.ByteBuffer;
import java.util.ArrayList;
import java.util.HashMap;
import java.util.List;
import java.util.Map;
import java.util.Set;
import java.util.concurrent.ConcurrentHashMap;
import java.util.concurrent.TimeUnit;

/**
 * A gateway of the original with some instances of one driver: writes their records, sends on their channel `data`, and
 * reads what a topology sends back on `control`.
 */
final class Gateway {
    private static final String SITE = "java-site";
    private static final int BEFORE = -1;  // the number of messages that do not count
    private final Records records;
    private final Wire wire;
    private final String kind;
    private final String server;
    private final Set<String> answered = ConcurrentHashMap.newKeySet();  // drivers that a topology has answered

    Gateway(Records records, Wire wire, String kind, String server) {
        this.records = records;
        this.wire = wire;
        this.kind = kind;
        this.server = server;
    }

    /** Message N has the time 1700000000000 + N and the property battery N; the answer also the gateway as `seen`. */
    String run(String driver, int count, int instances, boolean grouped) throws Exception {
        var tally = new Tally(count * instances);
        List<TSensor> sensors = new ArrayList<>();
        for (int i = 0; i < instances; i++) sensors.add(sensor(driver, "instance" + i, grouped));
        for (TSensor sensor : sensors) {
            if (!grouped || sensor == sensors.get(0)) {
                wire.open(sensor.getChannels().get(0));
                wire.read(sensor.getChannels().get(1), message -> take(message, tally));
            }
            records.write(sensor);
        }
        awaitReaders(sensors);
        for (int number = 0; number < count; number++) {
            for (TSensor sensor : sensors) send(sensor, number);
        }
        tally.await();
        for (TSensor sensor : sensors) records.remove(sensor);
        return tally.answer(count * instances);
    }

    /** Sends messages that do not count until a topology answers each driver: what comes before it reads is not for it. */
    private void awaitReaders(List<TSensor> sensors) throws Exception {
        long end = System.nanoTime() + TimeUnit.SECONDS.toNanos(Tally.LIMIT_S);
        while (answered.size() < sensors.size()) {
            if (System.nanoTime() > end) {
                throw new IllegalStateException("no topology answers the drivers within " + Tally.LIMIT_S + " s");
            }
            for (TSensor sensor : sensors) {
                if (!answered.contains(sensor.getSensorId())) send(sensor, BEFORE);
            }
            Thread.sleep(200);
        }
    }

    private void send(TSensor sensor, int number) throws Exception {
        wire.write(sensor.getChannels().get(0), Message.of(Integer.toString(number), expected(sensor.getSensorId(), number)));
    }

    private static Map<String, String> expected(String instance, int number) {
        return Map.of(Message.SENSOR, instance, Message.SITE, SITE, Message.TIME,
                Long.toString(1_700_000_000_000L + number), "battery", Integer.toString(number));
    }

    private void take(Message message, Tally tally) {
        String sensor = message.headers().getOrDefault(Message.SENSOR, "nobody");
        if (message.text().equals(Integer.toString(BEFORE))) {
            answered.add(sensor);
            return;
        }
        Map<String, String> expected = new HashMap<>(expected(sensor, Integer.parseInt(message.text())));
        expected.put("seen", SITE);
        tally.count(message.othersThan("battery", "seen"));
        boolean right = sensor.startsWith("instance") && message.says(expected);
        if (tally.isFirst(sensor + " " + message.text(), right)) tally.done();
    }

    private TSensor sensor(String driver, String instance, boolean grouped) {
        var sensor = new TSensor();
        sensor.setName(driver);
        sensor.setSiteId(SITE);
        sensor.setSensorId(instance);
        sensor.setState(TSensorState.DEPLOY);
        sensor.setMetadata(ByteBuffer.wrap("free text, not JSON".getBytes()));
        sensor.setChannels(List.of(channel(driver, instance, "data", TDirection.OUT, grouped),
                channel(driver, instance, "control", TDirection.IN, grouped)));
        return sensor;
    }

    /** The properties hold the names of all brokers as the driver gave them, without the prefix. */
    private TChannel channel(String driver, String instance, String name, TDirection direction, boolean grouped) {
        var channel = new TChannel();
        channel.setName(name);
        channel.setTransport(kind);
        channel.setDirection(direction);
        channel.setProperties(Map.of("exchange", driver + "_exchange", "routingKey", name + "_key", "queueName",
                name + "_queue", "topic", driver + "_" + name));
        channel.setBrokerUrl(server.replaceFirst("^kafka://", ""));
        channel.setSite(SITE);
        channel.setSensor(driver);
        channel.setSensorId(instance);
        channel.setGrouped(grouped);
        return channel;
    }
}
