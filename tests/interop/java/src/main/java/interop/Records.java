package interop;

import interop.original.TChannel;
import interop.original.TSensor;
import interop.original.TSensorState;
import java.util.HashMap;
import java.util.List;
import java.util.Map;
import java.util.concurrent.CountDownLatch;
import java.util.concurrent.TimeUnit;
import org.apache.thrift.TBase;
import org.apache.thrift.TDeserializer;
import org.apache.thrift.TSerializer;
import org.apache.thrift.protocol.TBinaryProtocol;
import org.apache.zookeeper.CreateMode;
import org.apache.zookeeper.KeeperException;
import org.apache.zookeeper.Watcher;
import org.apache.zookeeper.ZooDefs;
import org.apache.zookeeper.ZooKeeper;

/** What ZooKeeper says of drivers, by the original's rules: /iot/sensors/DRIVER/INSTANCE/CHANNEL. */
final class Records implements AutoCloseable {
    private static final String ROOT = "/iot/sensors";
    private final ZooKeeper zookeeper;

    Records(String servers) throws Exception {
        var connected = new CountDownLatch(1);
        zookeeper = new ZooKeeper(servers, 10_000, event -> {
            if (event.getState() == Watcher.Event.KeeperState.SyncConnected) connected.countDown();
        });
        if (!connected.await(Tally.LIMIT_S, TimeUnit.SECONDS)) throw new IllegalStateException("ZooKeeper does not answer");
    }

    /** The channels of that name of all instances of the driver that are deployed, by instance. */
    Map<String, TChannel> channels(String driver, String channel) throws Exception {
        Map<String, TChannel> found = new HashMap<>();
        for (String instance : children(ROOT + "/" + driver)) {
            String path = ROOT + "/" + driver + "/" + instance;
            TSensor sensor = read(new TSensor(), path);
            if (sensor.getState() != TSensorState.DEPLOY) continue;
            if (zookeeper.exists(path + "/" + channel, false) == null) continue;
            found.put(sensor.getSensorId(), read(new TChannel(), path + "/" + channel));
        }
        return found;
    }

    void write(TSensor sensor) throws Exception {
        String path = ROOT + "/" + sensor.getName() + "/" + sensor.getSensorId();
        put(path, bytes(sensor));
        for (TChannel channel : sensor.getChannels()) put(path + "/" + channel.getName(), bytes(channel));
    }

    void remove(TSensor sensor) throws Exception {
        sensor.setState(TSensorState.UN_DEPLOY);
        String path = ROOT + "/" + sensor.getName() + "/" + sensor.getSensorId();
        zookeeper.setData(path, bytes(sensor), -1);
        for (TChannel channel : sensor.getChannels()) zookeeper.delete(path + "/" + channel.getName(), -1);
        zookeeper.delete(path, -1);
    }

    static byte[] bytes(TBase<?, ?> record) throws Exception {
        return new TSerializer(new TBinaryProtocol.Factory()).serialize(record);
    }

    static <Record extends TBase<?, ?>> Record parse(Record record, byte[] bytes) throws Exception {
        new TDeserializer(new TBinaryProtocol.Factory()).deserialize(record, bytes);
        return record;
    }

    private <Record extends TBase<?, ?>> Record read(Record record, String path) throws Exception {
        return parse(record, zookeeper.getData(path, false, null));
    }

    private List<String> children(String path) throws Exception {
        try {
            return zookeeper.getChildren(path, false);
        } catch (KeeperException.NoNodeException absent) {
            return List.of();
        }
    }

    private void put(String path, byte[] data) throws Exception {
        for (int slash = path.indexOf('/', 1); slash > 0; slash = path.indexOf('/', slash + 1)) {
            create(path.substring(0, slash), new byte[0]);
        }
        if (!create(path, data)) zookeeper.setData(path, data, -1);
    }

    private boolean create(String path, byte[] data) throws Exception {
        try {
            zookeeper.create(path, data, ZooDefs.Ids.OPEN_ACL_UNSAFE, CreateMode.PERSISTENT);
            return true;
        } catch (KeeperException.NodeExistsException exists) {
            return false;
        }
    }

    @Override
    public void close() throws Exception {
        zookeeper.close();
    }
}
